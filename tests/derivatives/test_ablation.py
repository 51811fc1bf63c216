"""Without the area Jacobian, or directions that follow, derivatives of moving scenes are biased; with both they are not.

Reference: Worchel et al. 2025, arXiv 2504.05750.
"""

import pytest

from tests.derivatives.ablation import WITHOUT, without
from tests.derivatives.in_expectation import Effort, Estimate
from tests.derivatives.moving_scenes import SCENES

EFFORT = Effort(spp=64, batches=8)
SCENES_OF_THE_TEST = ("wall behind the camera", "plane under a soft lamp")


@pytest.mark.parametrize("name", SCENES_OF_THE_TEST)
@pytest.mark.parametrize("what", WITHOUT)
def test_each_part_is_needed(name, what):
    with without(*WITHOUT[what]):
        estimate = Estimate(SCENES[name]._replace(samplings=("hybrid",)), EFFORT)
        estimate.add_round()
        result = estimate.checks()["hybrid"]
    assert result.comparison.difference.isfinite().all() and result.comparison.difference.abs().max() > 0
    worst = max(abs(projection.z) for projection in result.comparison.projections)
    if what == "nothing":
        assert worst <= 4 and result.verdict in ("agrees", "too noisy"), str(result)
    else:
        assert worst > 6 and result.verdict.startswith("biased"), str(result)
