"""The part of a scene that lanes of one appearance read.

Functions of a bounce get no more than this, so that one that is compiled serves all scenes with that appearance, whatever
else they contain.
"""

from __future__ import annotations

from torch_radbp.record import leaves_of
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.light_choice import TreeChoice
from torch_radbp.scene.placement import for_lanes
from torch_radbp.scene.tensors import Layout, SceneTensors


def part_of(scene: SceneTensors, appearance: Appearance | None) -> SceneTensors:
    """The tables that matter where `appearance` is met; None: where nothing is scattered."""
    return reduced(scene, scene.layout, appearance)._replace(layout=layout_of_part(scene.layout, appearance))


def leaves_of_part(belonging: SceneTensors, layout: Layout, appearance: Appearance | None, nothing) -> list:
    """What belongs to the leaves of the part of a scene, as `leaves_of` counts them.

    Args:
        belonging: the record of the whole scene, with things that belong to its leaves in their places.
        layout: of the scene.
        appearance: of the part.
        nothing: what leaves that are no tables get.
    """
    record = reduced(belonging, layout, appearance)
    nothings = [nothing for _ in leaves_of(layout_of_part(layout, appearance))]
    return leaves_of(record._replace(layout=tuple(nothings)))


def reduced(scene: SceneTensors, layout: Layout, appearance: Appearance | None) -> SceneTensors:
    """A record like that of a scene with this layout, without the tables that its part has not."""
    triangles = scene.triangles._replace(balls=None, numbers=None, instances=for_lanes(scene.triangles.instances))
    if not (layout.radiance_bitmaps or (appearance is not None and appearance.needs_uv)):
        triangles = triangles._replace(vertices=triangles.vertices._replace(uv=None))
    wanted = attributes_of_part(layout, appearance)
    triangles = triangles._replace(
        vertices=triangles.vertices._replace(
            attributes=chosen(layout.vertex_attributes, triangles.vertices.attributes, wanted)),
        attributes=chosen(layout.face_attributes, triangles.attributes, wanted))
    if not (appearance is not None and appearance.kind.oriented):
        triangles = triangles._replace(along=None)
    readers = () if appearance is None else appearance.readers
    lights = scene.lights
    if isinstance(lights.choice, TreeChoice):  # the choice is made before the functions of the bounce run
        lights = lights._replace(choice=TreeChoice(lights.choice.pmf, *(None for _ in TreeChoice._fields[1:])))
    return scene._replace(
        lit=(), lights=lights, triangles=triangles,
        materials=scene.materials._replace(slots=scene.materials.slots[:len(readers)]),
        textures=tuple(() if reader.outside else scene.textures[layout.readers.index(reader)]
                       for reader in dict.fromkeys(readers)))


def layout_of_part(layout: Layout, appearance: Appearance | None) -> Layout:
    """The features that matter to the part."""
    appearances, readers = ((), ()) if appearance is None else ((appearance,), tuple(dict.fromkeys(appearance.readers)))
    return layout._replace(bending=False, appearances=appearances, readers=readers,
                           attributes=attributes_of_part(layout, appearance))


def attributes_of_part(layout: Layout, appearance: Appearance | None) -> tuple[str, ...]:
    """The attributes of meshes that the part reads, in the scene's order."""
    readers = (layout.radiance, *(() if appearance is None else appearance.readers))
    return tuple(name for name in layout.attributes if any(name in reader.attributes for reader in readers))


def chosen(names: tuple[str, ...], columns: tuple, wanted: tuple[str, ...]) -> tuple:
    """Those columns whose names are wanted, in their order."""
    return tuple(column for name, column in zip(names, columns) if name in wanted)
