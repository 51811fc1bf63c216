"""The part of a scene's tables that lanes of one appearance read.

Functions of a bounce get no more than this, so that one that is compiled serves all scenes with that appearance, whatever
else they contain.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.light_choice import TreeChoice
from torch_radbp.scene.tables.placement import for_lanes
from torch_radbp.scene.tables.scene_tensors import Layout, SceneTensors
from torch_radbp.tensors.record import leaves_of


def part_of(scene: SceneTensors, scatterer: Appearance | None, vertex: Hashable = None) -> SceneTensors:
    """The tables that are read where light is scattered by `scatterer`; None: where paths end. `vertex`: see `Layout`."""
    layout = replace(layout_of_part(scene.layout, scatterer), vertex=vertex)
    return _reduced(scene, scene.layout, scatterer)._replace(layout=layout)


def leaves_of_part(belonging: SceneTensors, layout: Layout, scatterer: Appearance | None) -> list:
    """Selects from things that belong to a scene's leaves (as gradients) those that belong to the leaves of a part.

    Args:
        belonging: the record of the whole scene, with things that belong to its leaves in their places.
        layout: of the scene.
        scatterer: of the part.
    """
    return leaves_of(_reduced(belonging, layout, scatterer))


def _reduced(scene: SceneTensors, layout: Layout, scatterer: Appearance | None) -> SceneTensors:
    """A scene record without the tables that its part does not read."""
    triangles = scene.triangles._replace(balls=None, numbers=None, instances=for_lanes(scene.triangles.instances))
    if not (layout.radiance_bitmaps or (scatterer is not None and scatterer.needs_uv)):
        triangles = triangles._replace(vertices=triangles.vertices._replace(uv=None))
    wanted = attributes_of_part(layout, scatterer)
    triangles = triangles._replace(
        vertices=triangles.vertices._replace(
            attributes=_chosen(layout.vertex_attributes, triangles.vertices.attributes, wanted)),
        attributes=_chosen(layout.face_attributes, triangles.attributes, wanted))
    if not (scatterer is not None and scatterer.kind.oriented):
        triangles = triangles._replace(along=None)
    readers = () if scatterer is None else scatterer.readers
    lights = scene.lights
    if isinstance(lights.choice, TreeChoice):  # the choice is made before the functions of the bounce run
        lights = lights._replace(choice=TreeChoice(lights.choice.pmf, *(None for _ in TreeChoice._fields[1:])))
    return scene._replace(
        lit=(), lights=lights, triangles=triangles,
        materials=scene.materials._replace(slots=scene.materials.slots[:len(readers)]),
        textures=tuple(() if reader.outside else scene.textures[layout.readers.index(reader)]
                       for reader in dict.fromkeys(readers)))


def layout_of_part(layout: Layout, scatterer: Appearance | None) -> Layout:
    """The `Layout` of a part of a scene: the features that its appearance needs."""
    readers = () if scatterer is None else tuple(dict.fromkeys(scatterer.readers))
    return replace(layout, bending=False, bends_ideally=False, appearances=(), readers=readers, scatterer=scatterer,
                   attributes=attributes_of_part(layout, scatterer), still=())


def attributes_of_part(layout: Layout, scatterer: Appearance | None) -> tuple[str, ...]:
    """The names of mesh attributes that a part of the scene reads, in the scene's order."""
    readers = (layout.radiance, *(() if scatterer is None else scatterer.readers))
    return tuple(name for name in layout.attributes if any(name in reader.attributes for reader in readers))


def _chosen(names: tuple[str, ...], columns: tuple, wanted: tuple[str, ...]) -> tuple:
    """Selects columns of attributes by name, in their order."""
    return tuple(column for name, column in zip(names, columns) if name in wanted)
