"""How many rays the backward pass casts: none if what they met was kept, exactly the replayed ones if not."""

import pytest
import torch

import torch_radbp as rb
from tests.gradients import cotangent
from tests.scenes import cornell, parameters


def rays(adjoint, **settings):
    """(rays of the forward pass, rays of the backward pass)."""
    scene = cornell()
    wanted = parameters(scene, ["white.reflectance.value"])
    renderer = rb.Renderer(scene, adjoint=adjoint, share_samples=True,
                           **{"spp": 2, "max_depth": 6, "rr_depth": 100} | settings)
    image = renderer(seed=1)
    forward = renderer.last_caster.rays_cast
    (gradient,) = torch.autograd.grad(image, wanted, cotangent(image.detach()))
    assert gradient.abs().max() > 0 and forward > 0
    return forward, renderer.last_caster.rays_cast - forward


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(1), rb.MemoizedAdjoint(2), rb.MemoizedAdjoint("sqrt"),
                                     rb.MemoizedAdjoint("log"), rb.QuadraticAdjoint(), rb.ReplayAdjoint()], ids=repr)
@pytest.mark.parametrize("settings", [{}, {"nee": False}, {"hide_emitters": True}, {"rr_depth": 1}], ids=str)
def test_the_backward_pass_casts_no_ray_if_hits_are_kept(adjoint, settings):
    assert rays(adjoint, **settings)[1] == 0


def test_rays_are_cast_again_if_hits_are_not_kept():
    forward, backward = rays(rb.MemoizedAdjoint(1, keep_hits=False))
    assert backward == forward  # the adjoint of each bounce asks once more
    forward, replayed = rays(rb.MemoizedAdjoint(3, keep_hits=False))
    assert forward < replayed <= 2 * forward  # each bounce once to differentiate it, most once more to get there
    assert rays(rb.MemoizedAdjoint("log", keep_hits=False))[1] > replayed
    assert rays(rb.QuadraticAdjoint(keep_hits=False))[1] > 3 * forward


def test_a_rendering_without_gradient_keeps_nothing_and_casts_the_same_rays():
    renderer = rb.Renderer(cornell(), spp=2, max_depth=6, rr_depth=100)
    assert not renderer(seed=1).requires_grad
    assert renderer.last_caster.rays_cast == rays(rb.MemoizedAdjoint())[0]
