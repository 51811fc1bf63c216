"""AOVs of the material at the first hit: its albedo, and the shading normal of normal and bump maps."""

from __future__ import annotations

from torch_radbp.aov.surface import Values
from torch_radbp.interface.texture import TextureValue
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import queued
from torch_radbp.path.state import Arrival, PathState, Settings
from torch_radbp.path.surface import surface_met
from torch_radbp.path.texture_networks import texture_values_at
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.lookup import lookup, summed
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import rows, where
from torch_radbp.vertex.material import material_at, material_places


def turns_normals(scene: SceneTensors) -> bool:
    """True if a material of the scene perturbs the shading normal (normal or bump map)."""
    return any(appearance.kind.turns_normals for appearance in scene.layout.appearances)


def material_values(integrand: Integrand, state: PathState, hit: Hit, names: tuple[str, ...],
                    normals: Values | None) -> tuple[Values, ...]:
    """The AOV "albedo" or "sh_normal" of camera paths; 0 where nothing is hit.

    Args:
        integrand: attached.
        state, hit: (N,) of camera paths.
        names: of the quantities.
        normals: the shading normals of surfaces whose material does not perturb them.
    """
    none = hit.t.new_zeros(hit.t.shape)
    quantities = {"albedo": (none, none, none), "sh_normal": normals}
    front, order, queues = queued(integrand, detached(state.ray), hit, False)
    for queue in queues:
        if not queue.event.scatters:
            continue
        lanes = order[queue.first:queue.last]
        here = rows(Arrival(state, hit, front), lanes)
        part = summed(integrand.part(queue.event).scene)
        places = material_places(part, surface_met(part, here, integrand.settings))
        texture_values = texture_values_at(integrand.scene, integrand.scatterer(queue.event), places)
        for name in names:
            if name == "albedo" or integrand.scatterer(queue.event).kind.turns_normals:
                values = integrand.stages(material_value)(part, here, texture_values, integrand.settings, name)
                quantities[name] = tuple(old.index_copy(0, lanes.long(), new) for old, new in zip(quantities[name], values))
    return tuple(quantities[name] for name in names)


def albedo(scene: SceneTensors, arrival: Arrival, texture_values: tuple[TextureValue, ...], settings: Settings) -> Values:
    """The albedo at the first hit, linear RGB; see `Kind.diffuse_reflectance`."""
    si = surface_met(scene, arrival, settings)
    material = material_at(scene, si, texture_values)
    return tuple(material.kind.diffuse_reflectance(material.values, si.wi))


def turned_normal(scene: SceneTensors, arrival: Arrival, texture_values: tuple[TextureValue, ...],
                  settings: Settings) -> Values:
    """The shading normal of a normal or bump map, world space; two-sided materials have the surface's, as in Mitsuba."""
    si = surface_met(scene, arrival, settings)
    material = material_at(scene, si, texture_values)
    front_row = lookup(scene.triangles.material, si.prim)
    two_sided = lookup(scene.materials.turned, front_row + scene.materials.count)
    surface_normal = si.frame.n * (1.0 - 2.0 * (~si.front & two_sided).to(si.t.dtype))
    return tuple(where(two_sided, surface_normal, si.frame.to_world(material.kind.shading_normal(material.values, si.wi))))


FUNCTIONS = {"albedo": albedo, "sh_normal": turned_normal}


@stage("scene")
def material_value(scene: SceneTensors, arrival: Arrival, texture_values: tuple[TextureValue, ...], settings: Settings,
                   name: str) -> Values:
    """One AOV of the material, for lanes whose camera rays hit one kind of material.

    Args:
        scene: the tables that these lanes read.
        arrival: the lanes' arrivals at the surface.
        texture_values: the values of textures that compiled code cannot evaluate, such as networks.
        settings: of the integrand.
        name: of the AOV.
    """
    return FUNCTIONS[name](scene, arrival, texture_values, settings)
