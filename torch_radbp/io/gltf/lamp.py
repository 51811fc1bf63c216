"""Reads the lights and cameras of a glTF document.

glTF's photometric units count as radiometric ones, number for number: candela as W / sr, lux as W / m^2, nits as
W / (m^2 sr), so that images are in nits. `lumens_per_watt` divides the intensities of lights, and not what surfaces emit:
683 is what Blender's exporter multiplies with, unless it is told otherwise.

Lights and cameras look along -z there, with y up, and along +z here.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from torch_radbp.emitter.directional import Directional
from torch_radbp.emitter.point import Point
from torch_radbp.emitter.spot import Spot
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.io.gltf.document import DocumentPart, Losses
from torch_radbp.plugin import Emitter, Sensor
from torch_radbp.pose import look_at
from torch_radbp.sensor.orthographic import Orthographic
from torch_radbp.sensor.perspective import Perspective
from torch_radbp.sensor.sampler import LowDiscrepancy

LEAST_RADIUS = 1e-4  # of a scene that a camera is made for, over its distance from the origin, where numbers are rounded
NEAREST = 1e-6  # near plane of an orthographic camera over its far plane: it may be 0 there and not here
FAR = 1e4  # where glTF has no far plane, unless the scene is larger
FIELD_OF_VIEW = 40.0  # degrees, of a camera that the file does not have
VIEWPOINT = (0.55, 0.45, 1.0)  # direction from which it looks at the scene; its front faces +z


def emitter_of_light(part: DocumentPart, to_world: np.ndarray, lumens_per_watt: float, losses: Losses) -> Emitter:
    """Reads a light of KHR_lights_punctual; inside a spot's penumbra it falls off linearly with the angle.

    Args:
        part: the light.
        to_world: (4, 4) place of its node.
    """
    amount = part.number("intensity", 1.0, low=0.0) / lumens_per_watt
    colour = torch.tensor([amount * share for share in part.numbers("color", 3, [1, 1, 1], low=0.0)], dtype=torch.float64)
    kind = part.text("type")
    if part.has("range"):
        losses.add(part.place, "range is not read: light falls off with the squared distance and does not end")
    if kind == "directional":
        return Directional(irradiance=colour, to_world=_rigid(part, to_world))
    if kind == "point":
        return Point(intensity=colour, position=torch.from_numpy(to_world[:3, 3].copy()))
    if kind != "spot":
        raise part.fail(f"type must be point, spot or directional, got {kind!r:.60}")
    cone = part.part("spot")
    outer = cone.number("outerConeAngle", math.pi / 4, low=0.0, high=math.pi / 2 + 1e-6)
    inner = cone.number("innerConeAngle", 0.0, low=0.0, high=math.pi / 2 + 1e-6)
    angles = {"cutoff_angle": math.degrees(outer), "beam_width": math.degrees(inner)}
    angles = Spot.of_file(angles, lambda what: losses.add(part.place, what))
    return Spot(intensity=colour, to_world=_rigid(part, to_world), **angles)


def _rigid(part: DocumentPart, to_world: np.ndarray) -> Tensor:
    """(4, 4) float64 rotation and translation of a transform, from glTF's axes (along -z) to ours (along +z)."""
    up, ahead = to_world[:3, 1], -to_world[:3, 2]
    left = np.cross(up, ahead)
    if not np.linalg.norm(left) > 1e-9 * np.linalg.norm(up) * np.linalg.norm(ahead):
        raise part.fail("its node flattens space, so that it has no direction")
    ahead, left = ahead / np.linalg.norm(ahead), left / np.linalg.norm(left)
    pose = np.eye(4)
    pose[:3] = np.stack([left, np.cross(ahead, left), ahead, to_world[:3, 3]], axis=1)
    return torch.from_numpy(pose)


def sensor_of_camera(part: DocumentPart, to_world: np.ndarray, resolution: int | None, spp: int, reach: float) -> Sensor:
    """Reads a camera as a sensor.

    Args:
        part: the camera.
        to_world: (4, 4) place of its node.
        resolution: pixels of the longer side; None: what `save` has noted, or 512.
        reach: how far the far plane lies away at least where the camera has none.
    """
    kind, size = part.text("type"), part.part("extras")
    pixels = tuple(size.integer(name, 0, high=2**15) for name in ("width", "height"))
    sampler = LowDiscrepancy(sample_count=spp)
    if kind == "perspective":
        lens = part.part("perspective")
        aspect = lens.number("aspectRatio", 1.0, low=1e-3, high=1e3)
        fov = math.degrees(lens.number("yfov", low=1e-6, high=math.pi - 1e-6))
        near = lens.number("znear", low=1e-12)
        far = lens.number("zfar", max(FAR, reach, 2 * near), low=near)
        return Perspective(to_world=_rigid(part, to_world), fov=fov, fov_axis="y", near_clip=near, far_clip=far,
                           sampler=sampler, film=film(aspect, resolution, pixels))
    if kind != "orthographic":
        raise part.fail(f"type must be perspective or orthographic, got {kind!r:.60}")
    lens = part.part("orthographic")
    across, up = (lens.number(name, low=1e-9, high=1e12) for name in ("xmag", "ymag"))
    pose = _rigid(part, to_world) @ torch.diag(torch.tensor([across, across, 1.0, 1.0], dtype=torch.float64))
    far = lens.number("zfar", low=1e-12)
    return Orthographic(to_world=pose, near_clip=max(lens.number("znear", low=0.0), NEAREST * far), far_clip=far,
                        sampler=sampler, film=film(across / up, resolution, pixels))


def film(aspect: float, resolution: int | None, pixels: tuple[int, ...]) -> HDRFilm:
    """A film of an aspect ratio width / height: of size `pixels` if that has it and no resolution is given."""
    width, height = pixels
    if resolution is None and min(pixels) > 0 and abs(width / height - aspect) < 1e-3 * aspect:
        return HDRFilm(width=width, height=height)
    longer = resolution or 512
    return HDRFilm(width=max(1, round(longer * min(1.0, aspect))), height=max(1, round(longer / max(1.0, aspect))))


def overview(low: np.ndarray, high: np.ndarray, resolution: int | None, spp: int) -> Perspective:
    """A camera that sees a box from the front, a little from the right and from above."""
    middle = 0.5 * (low + high)
    radius = max(0.5 * float(np.linalg.norm(high - low)), 1e-9, LEAST_RADIUS * float(np.abs(middle).max()))
    away = np.asarray(VIEWPOINT) / np.linalg.norm(VIEWPOINT)
    distance = 1.05 * radius / math.sin(math.radians(FIELD_OF_VIEW / 2))
    return Perspective(to_world=look_at((middle + distance * away).tolist(), middle.tolist(), [0, 1, 0]), fov=FIELD_OF_VIEW,
                       near_clip=0.01 * distance, far_clip=max(FAR, 10 * distance), film=film(1.0, resolution, (0, 0)),
                       sampler=LowDiscrepancy(sample_count=spp))
