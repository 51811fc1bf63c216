"""Derivatives of media beside differences with samples of their own, of kinds that the other files here do not hold.

Along one direction through all entries, of whole vectors in deep tests, to one side at the ends of ranges;
`python -m benchmarks.media_derivatives` has all rows, and more samples.
"""

from __future__ import annotations

import pytest

from tests.deep import deep
from tests.medium.differences import Experiment
from tests.scenes.media_rows import Row

NOISIEST = 0.15  # of the size of a derivative
WHOLE = [  # vectors, also in quick tests: only one is empty in one colour, and along one direction a table hardly changes
    Row("empty in red", "dielectric", "glow", "extinction"), Row("coloured", "null", "point", "values", "tabphase", depth=2)]
ROWS = [
    Row("fog", "none", "point", "extinction", "hg", depth=2),  # with nothing behind
    Row("coloured", "null", "directional", "extinction", "hg", depth=2),
    Row("coloured", "null", "spot", "extinction", "hg", "inside"),
    Row("coloured", "null", "point", "weight", "blendphase 0.0"),
    Row("grey", "roughdielectric", "glow", "g", "hg"),
    Row("coloured", "null", "point", "place of the bulb", depth=2),
]
MORE = [
    Row("fog", "none", "spot", "extinction", "hg", depth=2),
    Row("grey", "dielectric", "constant", "extinction", embedded="stone"),
    Row("coloured", "null", "directional", "extinction", "hg"),
    Row("coloured", "null", "point", "values", "tabphase"),
]


@pytest.mark.deep
def test_boundaries_that_move_are_seen_by_what_scatters_without_a_jump():
    """A ball of another medium in a medium, seen by flights that scatter more than once."""
    experiment = Experiment(Row("grey", "null", "glow", "pose of the core", embedded="core"), spp=2048)
    for _ in range(40):
        experiment.add_batch()
    found = experiment.comparison()
    assert 0 < found.noise < 0.03 and found.z < found.bound, found


@pytest.mark.parametrize("row, along, spp", [
    *((row, False, 24) for row in WHOLE), *((row, True, 24) for row in ROWS),
    *(deep(row, False, 64) for row in [*ROWS, *MORE])], ids=str)
def test_derivatives_are_those_of_differences(row, along, spp):
    experiment = Experiment(row, spp, compile=False, along=along)
    for _ in range(8):
        experiment.add_batch()
    found = experiment.comparison()
    assert 0 < found.noise < NOISIEST
    assert found.error < 0.01 or found.z < 1.3 * found.bound, found  # by eight batches errors are known to within a third
