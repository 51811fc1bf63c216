"""The camera in the place of the lights: what paths from lamps connect to.

Along a path from a lamp, W_k being what the power that arrives at vertex k brings to the loss,

    W_k = C_k + F_k W_{k+1}

where C_k connects the vertex to the camera. This is the recursion of radiance with camera and lamp exchanged. So the camera
is a kind of light without extent: what it "sends" to a point is the derivative of the loss at the pixels in which the point
counts, times the area of the image for each area there. Forwards, where no loss is known, that derivative is left out, and
what paths bring is deposited on the film (`call/light_film.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.position import FilmTensors
from torch_radbp.interface.emitter import Aim, LightKind, Pick
from torch_radbp.sampling.alias import alias_table
from torch_radbp.sampling.sampler import unit
from torch_radbp.scene.tables.scene_tensors import LightTable, SceneTensors
from torch_radbp.sensor.kind import Camera, Lens, ProjectiveKind
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import mapped
from torch_radbp.tensors.vec import Vec2, Vec3, normalize


class CameraTable(NamedTuple):
    """The camera as a light table of one row."""

    lens: Lens  # (1,) each, attached
    film: FilmTensors
    # The derivative of the loss by each pixel of the window, and zeros for those of the film's `margin` around it; detached.
    pixels: Vec3  # (P,), row by row; forwards (1,), not read


@dataclass(frozen=True)
class CameraAsLight(LightKind):
    """The camera as a light without extent, to which vertices of paths from lamps connect.

    Args:
        camera: the kind of camera.
        asked: True if the derivative of the loss by pixels is known; else it is left out.
    """

    camera: ProjectiveKind
    asked: bool = False
    delta: ClassVar[bool] = True

    def aim(self, table: CameraTable, proposal: CameraTable, p: Vec3, pick: Pick) -> Aim:
        lens, film = lookup(table.lens, pick.row), table.film
        aperture = Vec2(unit(pick.u, p.x.dtype), unit(pick.v, p.x.dtype)) if self.camera.has_aperture else None
        sight = self.camera.sight(lens, p, aperture)
        place = film.place(sight.position)
        # The image is the integral over positions on the film, each pixel having an area of 1.
        density = sight.density * (film.size_x * film.size_y)
        sent = Vec3(density, density, density)
        if self.asked:
            asked = none = Vec3.full(density, 0.0)
            first, down, across = film.patch(place)
            apart = film.columns + 2 * film.margin
            for row, in_row in enumerate(down):
                pixels = ((lookup(table.pixels, first + (apart * row + column)), each) for column, each in enumerate(across))
                asked = asked + sum((pixel * each for pixel, each in pixels), none) * in_row
            sent = asked * density
        counts = sight.ahead & film.is_near(place)
        return Aim(normalize(sight.target - p), pick.pmf * counts.to(density.dtype), sight.target, uv=place, radiance=sent)


def from_lamps(scene: SceneTensors, camera: Camera) -> SceneTensors:
    """The scene for paths that begin at lamps, with the camera in place of the lights; attached to both."""
    first = camera.film.size_x.new_zeros(1)
    table = CameraTable(mapped(camera.lens, lambda part: part[None] if isinstance(part, Tensor) else part),
                        camera.film.without_border(),
                        Vec3(first, first, first))
    none = torch.zeros(1, dtype=torch.int32, device=scene.device)
    lights = LightTable(alias_table(torch.ones_like(first)), none, none, none, (table,), first[0])
    layout = replace(scene.layout, lights=(CameraAsLight(camera.kind),), lit=(), radiance_bitmaps=False, from_lamps=True)
    return scene._replace(lights=lights, lit=(), layout=layout)


def with_pixel_adjoints(scene: SceneTensors, pixels: Vec3) -> SceneTensors:
    """A scene from `from_lamps` with the derivative of the loss by pixels, see `CameraTable`."""
    table, = scene.lights.tables
    kind, = scene.layout.lights
    return scene._replace(lights=scene.lights._replace(tables=(table._replace(pixels=pixels),)),
                          layout=replace(scene.layout, lights=(replace(kind, asked=True),)))
