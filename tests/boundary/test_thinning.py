"""Some samples stand for all: sums keep their expectation, large ones are always kept, and about as many as asked for."""

import pytest
import torch

import torch_radbp as rb
from tests.scenes.shadows import SHADOWS
from torch_radbp.boundary.eye.thinning import chances, thinned
from torch_radbp.boundary.terms import hidden_light

STARTS = torch.arange(4096, dtype=torch.float64).add(0.5).div(4096)


def sizes(*, count=500, seed=0):
    """Most are small, some are 0, and three are larger than the rest together."""
    generator = torch.Generator().manual_seed(seed)
    size = torch.rand(count, generator=generator, dtype=torch.float64)
    size[::7] = 0.0
    size[[5, 100, 401]] = 1e4
    return size


@pytest.mark.parametrize("most", [4, 50, 300])
def test_chances_are_in_proportion_and_sum_up_to_what_is_asked_for(most):
    size = sizes()
    chance = chances(size, most)
    assert 0.999 * most < float(chance.sum()) < most + 1e-9
    assert (chance[[5, 100, 401]] == 1.0).all() and (chance[::7] == 0.0).all()
    small = (chance < 1.0) & (size > 0.0)
    ratio = chance[small] / size[small]
    assert small.sum() > 100 and torch.allclose(ratio, ratio[0].expand_as(ratio))


def test_all_that_count_are_kept_where_more_are_asked_for():
    size = sizes()
    assert ((chances(size, 1000) == 1.0) == (size > 0.0)).all()
    assert not chances(torch.zeros(5, dtype=torch.float64), 3).any()


def test_sums_keep_their_expectation():
    """Over evenly spread starts each is kept as often as its chance says."""
    size = sizes()
    chance = chances(size, 50)
    value = size * torch.sin(torch.arange(len(size)))
    kept = [thinned(chance, u) for u in STARTS]
    assert all(49 <= len(own) <= 51 for own in kept)
    found = torch.stack([(value[own] / chance[own]).sum() for own in kept]).mean()
    assert float(value.sum()) != 0.0
    assert float(found) == pytest.approx(float(value.sum()), abs=1e-3 * float(value.abs().sum()))


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
def test_the_derivative_is_the_same_of_rounds_of_which_little_is_kept(monkeypatch):
    """A plate over a floor under an even sky, in sums over the film by which noise is small."""
    moving, found, kept, made = SHADOWS["plate, constant"], {}, [], hidden_light.joined_cuts

    def noted(cuts):
        kept.append((len(cuts), sum(len(own.cuts.edge) for own, _ in cuts)))
        return made(cuts)

    monkeypatch.setattr(hidden_light, "joined_cuts", noted)
    for most in (1 << 16, 512):
        monkeypatch.setattr(hidden_light, "MOST", most)
        scene = moving.build()
        found[most] = torch.stack([rb.jvp(scene, {moving.name: moving.tangent(scene)}, spp=256, seed=seed,
                                          max_depth=moving.max_depth, terms=("shadow",))[0] for seed in range(6)]).double()
        assert found[most].isfinite().all() and found[most].abs().max() > 0
    assert [rounds for rounds, _ in kept] == [1] * 6 + [8] * 6
    assert all(cuts <= 512 * hidden_light.PLACES + 8 for rounds, cuts in kept if rounds == 8)
    assert all(2000 < cuts < before for (_, before), (_, cuts) in zip(kept, kept[6:]))
    weights = found[1 << 16][4:].mean(0).sign()  # of other seeds than those that are compared
    once, rounds = ((images[:4] * weights).sum((1, 2, 3)) for images in found.values())
    noise = (float(once.var() + rounds.var()) / len(once))**0.5
    assert noise < 0.05 * float(once.mean())
    assert abs(float(once.mean() - rounds.mean())) < 4.0 * noise
