"""Burley's materials change without a jump where a parameter reaches an end of its range, or is left out."""

import pytest
import torch

from tests.bsdf.lanes import directions, material, values_of
from torch_radbp.bsdf import principled, principledthin

COUNT = 2000
STEP = 1e-7
ALL = {"base_color": [0.8, 0.3, 0.5], "roughness": 0.4, "anisotropic": 0.4, "spec_trans": 0.5, "spec_tint": 0.4,
       "sheen": 0.6, "sheen_tint": 0.3, "flatness": 0.3}
MATERIALS = {"principled": ALL | {"metallic": 0.4, "specular": 0.6, "clearcoat": 0.7, "clearcoat_gloss": 0.3},
             "principledthin": ALL | {"eta": 1.4, "diff_trans": 0.8}}
FEATURES = {"principled": ("specular", *principled.FEATURES),
            "principledthin": tuple(name for name in principledthin.FEATURES if name != "eta")}
ENDS = [(kind, name, end) for kind, names in FEATURES.items() for name in names for end in (0.0, 1.0)]


def value(kind: str, **changes: float) -> torch.Tensor:
    """(N, 3) BSDFs of pairs of directions."""
    bsdf = material({"type": kind} | MATERIALS[kind] | changes)
    wi, wo = directions(COUNT, 1), directions(COUNT, 2)
    return bsdf.kind().eval(values_of(bsdf, wi.z), wi, wo).stack().detach()


def assert_near(exact: torch.Tensor, close: torch.Tensor) -> None:
    assert exact.isfinite().all() and exact.max() > 0.1
    assert (exact - close).abs().max() < 1e-3 * exact.max()


@pytest.mark.parametrize("kind, name, end", ENDS)
def test_what_is_scattered_has_no_jump_at_the_end_of_a_range(kind, name, end):
    """It may have a steep slope there, such as that of a root. Densities may jump: what is zero is left out of the code."""
    assert_near(value(kind, **{name: end}), value(kind, **{name: end + (STEP if end == 0 else -STEP)}))


@pytest.mark.parametrize("end", [0.0, 1.0])
@pytest.mark.parametrize("kind", MATERIALS)
def test_there_is_no_jump_where_all_reach_an_end_together(kind, end):
    step = STEP if end == 0 else -STEP
    assert_near(*(value(kind, **{name: end + change for name in FEATURES[kind]}) for change in (0.0, step)))
