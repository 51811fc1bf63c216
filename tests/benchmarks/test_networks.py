"""What `benchmarks.networks` measures."""

from benchmarks.networks import BATCHES, Alone, Row, Step, measure, mlp, points_of
from benchmarks.scenes import QUICK


def test_a_row_has_all_times():
    row = measure(QUICK, 1)
    assert 0 < row.points <= QUICK.resolution**2 * QUICK.spp * QUICK.max_depth
    assert min(row.without, row.beside, row.alone, row.at_once) > 0


def test_the_ratio_leaves_out_the_network():
    assert Row(QUICK, 1, without=2.0, beside=5.0, alone=2.0, at_once=4.0).ratio == 1.5


def test_the_network_alone_gets_as_many_points_as_an_image_has():
    module = mlp()
    points = points_of(Step(QUICK, module), module)
    counts: list[tuple[int, bool]] = []
    module.register_forward_hook(lambda module, given, values: counts.append((len(values), values.requires_grad)))
    for batch in BATCHES:
        Alone(module, points, batch)(0)
        assert [sum(count for count, recorded in counts if recorded == wanted) for wanted in (False, True)] == [points] * 2
        counts.clear()


def test_a_step_trains_the_network():
    module = mlp()
    before = module[0].weight.detach().clone()
    Step(QUICK, module)(0)
    assert (module[0].weight != before).any()
