"""Shapes: everything becomes triangles; analytic ones are tessellated finely and keep exact normals."""

from torch_radbp.shape import cube, disk, mesh, rectangle, sphere  # noqa: F401 (registers the plugins)
