"""Without the area Jacobian, or directions that follow, derivatives of moving scenes are biased; with both they are not.

Reference: Worchel et al. 2025, arXiv 2504.05750.
"""

from itertools import product

import pytest

from tests.deep import deep
from tests.derivatives.ablation import WITHOUT, without
from tests.derivatives.in_expectation import Effort, Estimate
from tests.scenes.moving import SCENES

# No edge moves there. Of "nothing" so much that a bias of 5% would be noticed.
ROUGH_EFFORT = Effort(spp=64, batches=8, terms=("interior",))
EFFORT = {"nothing": ROUGH_EFFORT._replace(spp=128)}
SCENES_OF_THE_TEST = ("wall behind the camera", "plane under a soft lamp")
QUICK = (("wall behind the camera", "the area Jacobian"), ("plane under a soft lamp", "nothing"),
         ("plane under a soft lamp", "re-attached directions"))


@pytest.mark.parametrize("name, what", [
    case if case in QUICK else deep(*case) for case in product(SCENES_OF_THE_TEST, WITHOUT)])
def test_each_part_is_needed(name, what):
    with without(*WITHOUT[what]):
        estimate = Estimate(SCENES[name]._replace(samplings=("hybrid",)), EFFORT.get(what, ROUGH_EFFORT))
        estimate.add_round()
        result, scaled = (estimate.checks(error)["hybrid"] for error in (0.0, 0.05))
    assert result.comparison.difference.isfinite().all() and result.comparison.difference.abs().max() > 0
    worst = max(abs(projection.z) for projection in result.comparison.projections)
    if what == "nothing":
        assert worst <= 4 and result.verdict == "agrees", str(result)
        assert scaled.verdict.startswith("biased"), str(scaled)
    else:
        assert worst > 6 and result.verdict.startswith("biased"), str(result)
