"""Shapes: all become triangles; analytic shapes are tessellated finely and keep their exact normals."""

from torch_radbp.shape import (  # noqa: F401 (registers the plugins)
    cube,
    cylinder,
    disk,
    instance,
    mesh,
    rectangle,
    sdfgrid,
    serialized,
    shapegroup,
    sphere,
)
