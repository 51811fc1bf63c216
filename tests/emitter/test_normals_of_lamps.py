"""Light of a mesh with normals at its vertices: what it sends follows from its true area, as a quadrature says.

Mitsuba 3.9.1 divides by the cosine at the vertex normals where it samples the lamp, and by that of the geometry nowhere: its
two strategies, next-event estimation and sampling of the BSDF, converge to different images.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.scenes import look_at, rgb

HEIGHT, HALF, RADIANCE, REFLECTANCE = 2.0, 0.6, 4.0, 0.8
TILT = np.radians(50)
CORNERS = np.array([[-HALF, -HALF, HEIGHT], [-HALF, HALF, HEIGHT], [HALF, HALF, HEIGHT], [HALF, -HALF, HEIGHT]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
NORMAL = np.array([np.sin(TILT), 0, -np.cos(TILT)])
EMITTER = {"type": "area", "radiance": rgb(RADIANCE, RADIANCE, RADIANCE)}
PLACE = np.array([0.5, 0.2, 0.0])  # that is looked at


def expected() -> float:
    """Radiance of the floor at `PLACE`, by the midpoint rule over the lamp."""
    steps = (np.arange(400) + 0.5) / 400 * 2 * HALF - HALF
    x, y = np.meshgrid(steps, steps)
    reach = np.stack([x - PLACE[0], y - PLACE[1], np.full_like(x, HEIGHT)], -1)
    squared = (reach**2).sum(-1)
    assert (reach @ NORMAL < 0).all()  # the vertex normals face the place, too
    return REFLECTANCE / np.pi * RADIANCE * (HEIGHT**2 / squared**2).mean() * (2 * HALF) ** 2


def scene(pose, lamp) -> dict:
    return {
        "type": "scene", "lamp": lamp,
        "sensor": {"type": "perspective", "fov": 0.5, "to_world": pose,
                   "film": {"type": "hdrfilm", "width": 2, "height": 2, "pixel_format": "rgb", "rfilter": {"type": "box"}}},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": REFLECTANCE}},
    }


POSE = look_at((0.5, 3.0, 1.5), tuple(PLACE), (0, 0, 1))


@pytest.mark.parametrize("nee", [True, False])
def test_light_follows_from_the_true_area_of_the_lamp(nee):
    lamp = {"type": "mesh", "vertex_positions": CORNERS, "faces": FACES, "vertex_normals": np.tile(NORMAL, (4, 1)),
            "emitter": EMITTER}
    image = rb.render(rb.load_dict(scene(POSE, lamp)), spp=4096, max_depth=2, nee=nee)
    assert image.mean() == pytest.approx(expected(), rel=0.02)


def test_mitsubas_strategies_disagree(mi, tmp_path):
    rows = ["{} {} {} {} {} {}".format(*corner, *NORMAL) for corner in CORNERS]
    columns = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    (tmp_path / "lamp.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 4\n{columns}element face 2\n"
                                       "property list uchar int vertex_indices\nend_header\n"
                                       + "\n".join([*rows, "3 0 1 2", "3 0 2 3"]) + "\n")
    lamp = {"type": "ply", "filename": str(tmp_path / "lamp.ply"), "emitter": EMITTER}
    theirs = mi.load_dict(scene(mi.ScalarTransform4f(torch.as_tensor(POSE).numpy()), lamp))

    def mean(**samples) -> float:
        integrator = mi.load_dict({"type": "direct", **samples})
        return float(mi.render(theirs, spp=16384, integrator=integrator).numpy().mean())

    assert mean(emitter_samples=0, bsdf_samples=1) == pytest.approx(expected(), rel=0.02)
    assert abs(mean(emitter_samples=1, bsdf_samples=0) / expected() - 1) > 0.1
