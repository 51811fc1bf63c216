"""Where no silhouette moves, the derivative is that of finite differences with independent samples, in expectation."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but, deep_but_every
from tests.derivatives.in_expectation import Effort, Estimate, Row, assert_agrees
from tests.scenes import sensor
from tests.scenes.moving import FLOOR, SCENES, TURN, rigid, scene
from torch_radbp.io.values.transform import rotate

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

SPECULAR = [name for name in SCENES if name.startswith(("lens", "mirror", "pane"))]
BATCHES = 8
# Of which 8 happen to be too much alike.
MORE_BATCHES = {"field of view": 16, "outline of a cube, camera": 16, "outline of a ball": 16}
SPP = 16  # of a batch, where `NOISY` does not ask for more; chosen by `python -m benchmarks.derivatives`
NOISY = {
    "plane under a sky": 32, "plane turned under an envmap": 64, "metal turned under an envmap": 64,
    "camera before metal under an envmap": 64, "soft lamp moved": 256, "plane under a soft lamp": 256, "lamp moved": 128,
    "plane under a lamp": 128, "metal under a soft lamp": 512, "rough glass shifted": 256, "rough glass turned": 256,
    "ggx glass shifted": 128, "ggx glass turned": 256, "ggx glass, index": 64, "rough glass, roughness": 256,
    "rough glass, index": 64, "emitter behind rough glass": 256, "pane, index": 512, "lens, vertices": 32,
    "lens, normals": 32, "lens, index": 256, "normals under an envmap": 1024, "envmap turned": 1024,
    "wall behind the camera": 1024, "principled glass, spec_trans": 64,
    "thinlens, aperture_radius": 256, "thinlens, focus_distance": 256, "calibrated, k2": 64, "calibrated, k3": 256,
    "calibrated, k4": 64, "calibrated, k5": 128, "calibrated, k6": 256, "fisheye, k4": 64,
    "one before another": 1024, "outline of a cube, camera": 2048, "outline without perspective": 2048,
    "where walls meet": 96}
COARSE = {"normals under an envmap": 256, "envmap turned": 256, "wall behind the camera": 512,
          "metal under a soft lamp": 128, "one before another": 256, "outline of a cube, camera": 320,
          "outline without perspective": 384}  # for 5%
# Of the same code as those, for 5%.
OUTLINES = {"outline of a cube": 512, "outline of a mesh": 512, "outline of a ball": 1024, "outline of an instance": 1024,
            "outline, thinlens": 1536, "outline, fisheye": 512}

# Some of each kind, the least noisy ones; the others are deep.
QUICK = ("plane shifted", "vertices with their normals", "texture turned", "envmap seen", "point light",
         "directional light", "emitter seen", "ggx glass, index", "mirror turned", "camera turned",
         "camera without perspective", "thinlens, aperture_radius", "calibrated, k2", "distances")
STATED = [*(Row(name, 0.02, NOISY.get(name, SPP)) for name in SCENES if name not in {**COARSE, **OUTLINES}),
          *(Row(name, 0.05, spp) for name, spp in COARSE.items()),
          *(Row(name, 0.02, NOISY[name]) for name in COARSE),
          *(Row(name, 0.05, spp) for name, spp in OUTLINES.items())]
ROWS = deep_but([row for row in STATED if row.name in QUICK], STATED)


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_derivatives_are_those_of_finite_differences(row):
    """And if they were wrong by the stated bias, that would be noticed."""
    # Where hybrid is attached, sample by sample, by one of them.
    moving = SCENES[row.name]._replace(samplings=("hybrid",)) if row.name in SPECULAR else SCENES[row.name]
    measured = Estimate(moving, Effort(row.spp, MORE_BATCHES.get(row.name, BATCHES)))
    measured.add_round()
    assert_agrees(measured, row)


@pytest.mark.parametrize("name", deep_but_every(2, SPECULAR))
def test_where_all_is_ideally_specular_hybrid_is_attached(name):
    """Sample by sample: no direction is left to chance."""
    moving = SCENES[name]
    build = moving.build().double()
    tangent = moving.tangent(build)
    settings = {"spp": 4, "max_depth": moving.max_depth, "compile": False}
    hybrid, attached = (rb.jvp(build, {moving.name: tangent}, sampling=sampling, **settings)
                        for sampling in ("hybrid", "attached"))
    assert attached.isfinite().all() and attached.abs().max() > 1e-3
    assert (hybrid - attached).abs().max() < 1e-12 * attached.abs().max()


def test_attached_directions_pass_the_cells_of_an_environment_map_without_a_jump():
    """The density that picks directions jumps at the border of a bright block; weights that did would bias this by 7%."""
    bright = np.full((16, 32, 3), 0.1)
    bright[3:6, 8:14] = 20
    sky = {"type": "envmap", "bitmap": bright, "to_world": rotate((0.3, 1, 0.4), 40) @ rotate((1, 0, 0), 90)}
    build = scene(sensor=sensor(2, (0.5, -0.4, 2.6), (0.1, 0.15, 0), 40), **FLOOR, sky=sky)()
    tangent = rigid(TURN)(build.get_parameter("plane.to_world"))
    estimates = []
    for first, sampling in enumerate(("hybrid", "attached")):
        estimates.append(torch.stack([
            rb.jvp(build, {"plane.to_world": tangent}, spp=2048, max_depth=2, seed=100 * first + k, sampling=sampling).mean()
            for k in range(12)]))
    glued, attached = (estimate.mean() for estimate in estimates)
    error = torch.stack([estimate.var() / len(estimate) for estimate in estimates]).sum().sqrt()
    assert 4 * error < 0.05 * glued.abs()  # so that it can fail
    assert (attached - glued).abs() < 4 * error, (attached, glued, error)
