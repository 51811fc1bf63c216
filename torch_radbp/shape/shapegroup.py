"""Groups of shapes, which are stored once and shown by instances."""

from __future__ import annotations

from torch_radbp.plugin import Shape, register
from torch_radbp.shape.surface import Surface


@register("shape", "shapegroup")
class ShapeGroup(Shape):
    """Shapes that are visible only where an `instance` shows them.

    No parameters but those of its shapes, whose names are those in the group: `group.leaf.vertex_positions`. Their gradients
    are summed over the instances.

    Args:
        shapes: with their materials; without emitters, groups and instances, as in Mitsuba.

    Raises:
        ValueError: if one of them is not a plain surface, shines, or is the boundary of a medium.
    """

    def __init__(self, *, shapes: dict[str, Shape] | None = None):
        super().__init__()
        self.shape_names: tuple[str, ...] = ()
        for name, shape in (shapes or {}).items():
            if not isinstance(shape, Surface):
                raise ValueError(f"{name!r} is of type {shape.type}, which a shapegroup cannot hold: groups are not nested")
            if shape.emitter is not None:
                raise ValueError(f"the shape {name!r} carries an emitter, which cannot be instanced: put it into the scene")
            if shape.bounds_media:
                raise ValueError(f"the shape {name!r} is the boundary of a medium, which cannot be instanced: put it into "
                                 "the scene")
            name = name.replace(".", "_")
            while hasattr(self, name):
                name += "_"
            self.add_module(name, shape)
            self.shape_names = (*self.shape_names, name)

    @property
    def shapes(self) -> dict[str, Surface]:
        """The shapes by their names in the group."""
        return {name: getattr(self, name) for name in self.shape_names}
