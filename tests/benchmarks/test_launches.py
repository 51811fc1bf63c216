"""On a GPU the host starts each bounce of the benchmarks' scenes by one call, and waits for none of them."""

import pytest

from benchmarks import launches
from tests.deep import deep_but

pytest.importorskip("warp")
# In the end, for all that is presumed until then, and for whether the image is finite.
WAITS = {"metal-mesh-vertices": 2}  # before triangles that move get a new tree, too


@pytest.mark.parametrize("name", deep_but(["cornell-box"], launches.SCENES))
def test_between_bounces_the_host_waits_for_nothing_and_makes_one_call(name):
    forward, backward = launches.driven_of_benchmark(name)
    for found in (forward, backward):
        assert {what: found.of_bounce[what] for what in ("waits", "sent", "torch", "Python")} == {
            "waits": 0, "sent": 0, "torch": 0, "Python": 1}
        assert found.of_bounce["launches"] >= 5 and found.of_call["sent"] == 0
        # The context comes and goes, and it is asked whether the caller captures; by a graph all kernels are one call.
        assert found.of_bounce["driver"] == found.of_bounce["launches"] + 3 and found.of_bounce["by graphs"] == 4
        assert found.of_call["by graphs"] <= 20
    assert forward.of_call["waits"] == WAITS.get(name, 1)  # none of which is as often as there are parameters
    assert backward.of_call["waits"] == 1  # whether the gradients are finite


@pytest.mark.parametrize("name", deep_but(["boundaries", "networks"], ["boundaries", "smoke", "networks"]))
def test_media_are_passed_without_the_host_and_networks_asked_at_once(name):
    """Through media that scatter paths of the image and of its derivative are sampled otherwise: a call for each. Networks
    are run by torch, on as many lanes as ask each, for which the host waits once; not at the last bounce."""
    forward, backward = launches.driven_of_rarer(name)
    networks = name == "networks"
    for found in (forward, backward):
        assert found.of_bounce["sent"] == 0 and (networks or found.of_bounce["torch"] == 0)
    assert forward.of_bounce["waits"] == networks and backward.of_bounce["waits"] == 0
    assert networks or (forward.of_bounce["Python"], backward.of_bounce["Python"]) == (2, 1)
    assert forward.of_call["waits"] == 1 - networks and 1 <= backward.of_call["waits"] <= (3 if networks else 1)


def test_a_scene_of_few_triangles_that_move_waits_three_times():
    """Before its rays are cast, for whether the areas of lamps are as they were, and in the end."""
    forward, backward = launches.driven_of_rarer("moving box")
    assert forward.of_bounce["waits"] == backward.of_bounce["waits"] == 0
    assert (forward.of_call["waits"], backward.of_call["waits"]) == (3, 1)


def test_poses_of_instances_move_without_new_trees_of_their_groups():
    """The host waits for whether poses are as they were, before the tree over them is built, and in the end."""
    forward, backward = launches.driven_of_rarer("moving instances")
    assert forward.of_bounce["waits"] == backward.of_bounce["waits"] == forward.of_bounce["sent"] == 0
    assert (forward.of_call["waits"], forward.of_call["sent"], backward.of_call["waits"]) == (3, 0, 1)


def test_what_the_host_does_between_bounces_is_found(monkeypatch):
    """A bounce that is not recorded is driven from Python, and waits for numbers of lanes."""
    monkeypatch.setattr("torch_radbp.path.taped_bounces.recordable", lambda integrand: False)
    forward, _ = launches.driven_of_benchmark("cornell-box")
    assert forward.of_bounce["waits"] >= 1 and forward.of_bounce["Python"] > 5
