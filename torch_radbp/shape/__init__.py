"""Shapes: all become triangles; analytic shapes are tessellated finely and keep their exact normals."""

from torch_radbp.shape import cube, cylinder, disk, mesh, rectangle, serialized, sphere  # noqa: F401 (registers the plugins)
