"""Logarithms, ranges, and maps from coarse to fine, as parametrisations of what a scene has."""

import copy

import pytest
import torch
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.scenes import load, rectangle, sensor, texels
from torch_radbp.optim.coarse_to_fine import resampled


class Map(torch.nn.Module):
    """A module with a map in float64."""

    def __init__(self, *shape: int):
        super().__init__()
        generator = torch.Generator().manual_seed(0)
        self.data = torch.nn.Parameter(0.1 + 0.8 * torch.rand(*shape, dtype=torch.float64, generator=generator))


@pytest.mark.parametrize("parametrisation", [rb.optim.Log(), rb.optim.Sigmoid(), rb.optim.Sigmoid(-1, 3)], ids=str)
def test_values_stay_when_a_range_is_registered_and_derivatives_are_right(parametrisation):
    module = Map(4, 3)
    before = module.data.detach().clone()
    parametrize.register_parametrization(module, "data", parametrisation)
    torch.testing.assert_close(module.data, before, rtol=1e-12, atol=0)
    u = module.parametrizations.data.original.detach().clone().requires_grad_()
    assert torch.autograd.gradcheck(parametrisation, (u,))


def test_steps_are_ratios_and_stay_in_the_range():
    assert float(rb.optim.Log()(torch.tensor(2.0).log() + 0.1)) == pytest.approx(2 * 2.718281828**0.1)
    far = rb.optim.Sigmoid(0.2, 0.6)(torch.tensor([-200.0, 0.0, 200.0]))
    torch.testing.assert_close(far, torch.tensor([0.2, 0.4, 0.6]))


def test_values_at_the_ends_are_brought_inside():
    torch.testing.assert_close(rb.optim.Log(1e-3).right_inverse(torch.zeros(2)).exp(), torch.full((2,), 1e-3))
    inside = rb.optim.Sigmoid(0, 2, margin=0.01)
    torch.testing.assert_close(inside(inside.right_inverse(torch.tensor([0.0, 2.0]))), torch.tensor([0.02, 1.98]))
    with pytest.raises(ValueError, match="must not be negative to have a logarithm, got -1"):
        rb.optim.Log().right_inverse(torch.tensor([-1.0]))
    with pytest.raises(ValueError, match="values must be from 0 to 2, got -1 to 3"):
        inside.right_inverse(torch.tensor([-1.0, 3.0]))


SHAPES = {"whole ratio": ((2, 4), (8, 8, 3)), "odd": ((3, 5), (7, 11, 1)), "volume": ((2, 2, 3), (5, 4, 6, 1)),
          "larger than the map": ((20, 20), (4, 5, 3))}


@pytest.mark.parametrize("size, shape", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("sigmoid", [False, True], ids=["alone", "in a range"])
def test_the_value_stays_when_it_is_registered_and_refined(size, shape, sigmoid):
    """Bit by bit, but for what the sigmoid rounds when it is registered."""
    module = Map(*shape)
    before = module.data.detach().clone()
    within = rb.optim.Sigmoid() if sigmoid else None
    parametrize.register_parametrization(module, "data", rb.optim.CoarseToFine(size, within=within))
    torch.testing.assert_close(module.data.detach(), before, rtol=1e-12 if sigmoid else 0, atol=0)
    grid = module.parametrizations.data.original
    optimizer, sizes = torch.optim.Adam([grid], lr=0.1), []
    for _ in range(6):
        optimizer.zero_grad()
        (module.data - 0.5).square().sum().backward()
        optimizer.step()
        now = module.data.detach().clone()
        sizes.append(tuple(grid.shape))
        finer = rb.optim.refine(module, "data", optimizer)
        assert module.parametrizations.data.original is grid and torch.equal(module.data.detach(), now)
        assert finer == (sizes[-1][:-1] != shape[:-1])
    assert sizes[-1] == shape and not torch.equal(now, before)
    assert sizes[0] == (*(min(a, b) for a, b in zip(size, shape)), shape[-1])


def test_a_grid_is_interpolated_as_torch_does():
    grid = torch.rand(3, 5, 2, dtype=torch.float64)
    reference = torch.nn.functional.interpolate(grid.movedim(-1, 0)[None], (7, 16), mode="bilinear")[0].movedim(0, -1)
    torch.testing.assert_close(resampled(grid, (7, 16), (False, False)), reference)


def test_a_grid_that_wraps_knows_no_border():
    """Shifted by a cell, the result is shifted by the columns of a cell."""
    grid = torch.rand(3, 4, 1, dtype=torch.float64)
    one, other = (resampled(each, (3, 12), (False, True)) for each in (grid, grid.roll(1, 1)))
    torch.testing.assert_close(one.roll(3, 1), other)
    assert not torch.allclose(one, resampled(grid, (3, 12), (False, False)))


def test_derivatives_by_the_grid_are_those_of_differences():
    for wraps in (False, True):
        parametrisation = rb.optim.CoarseToFine((2, 3), wrap_rows=wraps, wrap_columns=wraps)
        parametrisation.right_inverse(Map(5, 7, 2).data)
        grid = torch.rand(2, 3, 2, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(parametrisation, (grid,))
        assert parametrisation(grid).shape == (5, 7, 2)


def test_a_bitmap_is_rendered_from_coarse_to_fine():
    """The image stays when the grid is refined, and gradients reach it; all as in a recovery."""
    bitmap = {"type": "bitmap", "data": texels(8, 8), "raw": True}
    scene = load(torch.float64, sensor=sensor(), sky={"type": "constant"},
                 wall=rectangle((0, 0, 0), bsdf={"type": "diffuse", "reflectance": bitmap}))
    renderer = rb.Renderer(scene, spp=4, max_depth=2)
    texture = scene.wall.bsdf.reflectance
    before = renderer(seed=1)
    parametrize.register_parametrization(texture, "data", rb.optim.CoarseToFine((2, 2)))
    grid = texture.parametrizations.data.original.requires_grad_()
    image = renderer(seed=1)
    assert torch.equal(image.detach(), before.detach())
    image.sum().backward()
    assert grid.grad.shape == (2, 2, 3) and (grid.grad > 0).all()
    with torch.no_grad():
        grid -= 0.05
    moved = renderer(seed=1).detach()
    assert rb.optim.refine(texture, "data") and grid.grad is None
    again = renderer(seed=1)
    assert not torch.equal(moved, before.detach()) and torch.equal(again.detach(), moved)
    again.sum().backward()
    assert grid.grad.shape == (4, 4, 3)


def test_an_environment_is_rendered_from_coarse_to_fine_in_logarithms():
    scene = load(torch.float64, sensor=sensor(), sky={"type": "envmap", "data": texels(4, 8)}, ball={"type": "sphere"})
    renderer = rb.Renderer(scene, spp=4, max_depth=2)
    before = renderer(seed=1).detach()
    sky = rb.optim.CoarseToFine((2, 2), wrap_columns=True, within=rb.optim.Log())
    parametrize.register_parametrization(scene.sky, "data", sky)
    scene.sky.parametrizations.data.original.requires_grad_()
    image = renderer(seed=1)
    torch.testing.assert_close(image.detach(), before, rtol=1e-9, atol=0)
    image.sum().backward()
    assert (scene.sky.parametrizations.data.original.grad > 0).all()


def test_copies_and_state_dicts_keep_what_has_been_found():
    module = Map(6, 6, 1)
    parametrize.register_parametrization(module, "data", rb.optim.CoarseToFine((2, 2)))
    module.parametrizations.data.original.data += 0.3
    other = copy.deepcopy(module)
    assert torch.equal(other.data, module.data)
    fresh = Map(6, 6, 1)
    parametrize.register_parametrization(fresh, "data", rb.optim.CoarseToFine((2, 2)))
    assert not torch.equal(fresh.data, module.data)
    fresh.load_state_dict(module.state_dict())
    assert torch.equal(fresh.data, module.data)


def test_what_cannot_be_refined_is_told():
    module = Map(6, 6, 1)
    with pytest.raises(ValueError, match="data of Map is not parametrized by CoarseToFine"):
        rb.optim.refine(module, "data")
    parametrize.register_parametrization(module, "data", rb.optim.Sigmoid())
    with pytest.raises(ValueError, match="not parametrized by CoarseToFine; register that first"):
        rb.optim.refine(module, "data")
    with pytest.raises(ValueError, match=r"for a grid of 2 x 2 must have 3 axes, the last of channels, got shape \(6, 6\)"):
        rb.optim.CoarseToFine((2, 2)).right_inverse(torch.zeros(6, 6))
    for size in ((2,), (2, 2, 2, 2)):
        with pytest.raises(ValueError, match="size must be rows and columns, or depth, rows and columns"):
            rb.optim.CoarseToFine(size)


def test_bad_ranges_are_named():
    with pytest.raises(ValueError, match="low must be less than high, got 1 and 0"):
        rb.optim.Sigmoid(1, 0)
    with pytest.raises(ValueError, match="margin must be between 0 and 0.5, got 0"):
        rb.optim.Sigmoid(margin=0)
    with pytest.raises(ValueError, match="least must be greater than 0"):
        rb.optim.Log(0)
