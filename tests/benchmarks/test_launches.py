"""On a GPU the host starts each bounce of the benchmarks' scenes by one call, and waits for none of them."""

import pytest

from benchmarks import launches
from tests.deep import deep_but

pytest.importorskip("warp")
# Whether tensors are as they were, parameters in their domains, the image finite; and a sky that is learned not black.
WAITS = {"metal-mesh": 4, "metal-mesh-vertices": 16}  # what moves gets a new tree of triangles, too


@pytest.mark.parametrize("name", deep_but(["cornell-box", "metal-mesh"], launches.SCENES))
def test_between_bounces_the_host_waits_for_nothing_and_makes_one_call(name):
    forward, backward = launches.driven_of_benchmark(name)
    for found in (forward, backward):
        assert {what: found.of_bounce[what] for what in ("waits", "sent", "torch", "Python")} == {
            "waits": 0, "sent": 0, "torch": 0, "Python": 1}
        assert found.of_bounce["launches"] >= 5 and found.of_call["sent"] == 0
    assert 3 <= forward.of_call["waits"] <= WAITS.get(name, 3)  # none of which is as often as there are parameters
    assert backward.of_call["waits"] == 1  # whether the gradients are finite


def test_what_the_host_does_between_bounces_is_found(monkeypatch):
    """A bounce that is not recorded is driven from Python, and waits for numbers of lanes."""
    monkeypatch.setattr("torch_radbp.path.taped_bounces.recordable", lambda integrand: False)
    forward, _ = launches.driven_of_benchmark("cornell-box")
    assert forward.of_bounce["waits"] >= 1 and forward.of_bounce["Python"] > 5
