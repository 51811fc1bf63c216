"""Paths whose vertices look at edges are spread over the film by how near these are, and count by the inverse."""

import pytest
import torch

import torch_radbp as rb
from tests.scenes.shadows import SHADOWS
from torch_radbp.boundary.eye import film_density
from torch_radbp.boundary.eye.viewpoints import cells_begun
from torch_radbp.boundary.terms import hidden_light

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")


@pytest.mark.parametrize("even", [True, False])
def test_areas_of_paths_add_up_to_that_of_each_cell(even):
    generator = torch.Generator().manual_seed(3)
    cells, count = 40, 100_000
    density = None if even else 0.5 + torch.rand(cells, generator=generator, dtype=torch.float64)**4
    along = torch.arange(count) + torch.rand(count, generator=generator, dtype=torch.float64)
    cell, area = cells_begun(along, count, cells, density)
    found = torch.zeros(cells, dtype=torch.float64).index_add(0, cell.long(), area.expand(count))
    assert cell.dtype == torch.int32 and (found - 1.0).abs().max() < 2e-3


def test_the_derivative_is_the_same_where_more_paths_go_to_edges(monkeypatch):
    """A plate over a floor under an even sky, in sums over the film by which noise is small."""
    moving = SHADOWS["plate, constant"]
    found, densities, made = {}, [], film_density.film_density

    def noted(*arguments):
        densities.append(made(*arguments))
        return densities[-1]

    monkeypatch.setattr(film_density, "film_density", noted)
    for name, fewest in (("even", 1 << 30), ("by edges", 1)):
        monkeypatch.setattr(film_density, "FEWEST", fewest)
        scene = moving.build()
        found[name] = torch.stack([rb.jvp(scene, {moving.name: moving.tangent(scene)}, spp=256, seed=seed, terms=("shadow",),
                                          max_depth=moving.max_depth)[0] for seed in range(6)]).double()
        assert found[name].isfinite().all() and found[name].abs().max() > 0
    assert len(densities) == 6
    for density in densities:
        assert float(density.mean()) == pytest.approx(1.0) and density.min() >= 1.0 - film_density.GUIDED
        assert density.max() > 2.0
    weights = found["even"].mean(0).sign()
    sums = {name: (images * weights).sum((1, 2, 3)) for name, images in found.items()}
    noise = sum(float(own.var()) / len(own) for own in sums.values())**0.5
    assert noise < 0.05 * float(sums["even"].mean())
    assert abs(float(sums["even"].mean() - sums["by edges"].mean())) < 4.0 * noise


def test_of_few_paths_none_is_tried(monkeypatch):
    monkeypatch.setattr(film_density, "film_density", lambda *_: pytest.fail("some were tried"))
    moving = SHADOWS["plate, constant"]
    scene = moving.build()
    assert hidden_light.SHARE * film_density.SHARE * film_density.FEWEST > 16 * 16 * 64
    image = rb.jvp(scene, {moving.name: moving.tangent(scene)}, spp=64, seed=0, max_depth=2, terms=("shadow",))
    assert image.isfinite().all() and image.abs().max() > 0
