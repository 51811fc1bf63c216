"""Whoever takes a bounce again goes by what was decided the first time, even where rounding would decide otherwise."""

import weakref

import torch
from torch import Tensor
from torch.utils._pytree import tree_map_only

import torch_radbp as rb
from tests.scenes import cornell, parameters
from tests.scenes.closed_box import closed_box
from torch_radbp.adjoint.local_map import Verdict, local_map
from torch_radbp.adjoint.record import record_wavefront
from torch_radbp.call.pixels import Films
from torch_radbp.call.render_call import start_paths
from torch_radbp.path.state import Arrival
from torch_radbp.path.step import survivors
from torch_radbp.path.wavefront import bounces, take_step
from torch_radbp.tensors.vec import rows

SETTINGS = {"spp": 4, "max_depth": 5, "rr_depth": 1}


def first_bounces():
    """The integrand of a Cornell box with roulette from the first bounce on, and the bounces of its paths."""
    call = rb.Renderer(cornell(), **SETTINGS).prepare(0, None, SETTINGS["spp"], None)
    integrand = call.make_integrand(tree_map_only(Tensor, Tensor.detach, call.scene))
    return integrand, list(bounces(integrand, start_paths(call, call.wavefronts[0], 0)))


def test_a_bounce_taken_again_keeps_the_survivors_although_rounding_differs():
    integrand, taken = first_bounces()
    for depth, state, _, _, step in taken[:-1]:
        # As another device or another compiler might: far more than rounding, so that roulette would decide otherwise.
        other = state._replace(beta=state.beta * (1 + 0.2 * torch.linspace(-1, 1, len(state.lane), dtype=torch.float64)))
        vertex, _, again = take_step(integrand, other, depth, step)
        assert again is step
        assert 0 < int((vertex.survives != step.survives).sum()) < len(state.lane)
        assert torch.equal(survivors(integrand, vertex.next, again).lane, state.lane[step.order][step.survives])


def test_the_derivative_is_that_of_the_recorded_survivors():
    integrand, taken = first_bounces()
    depth, state, vertex, _, step = taken[0]
    flipped = step._replace(survives=~step.survives)
    part, = (integrand.part(queue.event) for queue in step.queues)
    for decided in (step, flipped):
        arrival, verdict = rows(Arrival(state, decided.hit, None), step.order), Verdict(decided.visible, decided.survives)
        local = local_map(part.scene, part.proposal, arrival, verdict, integrand.at(depth),
                          integrand.settings_at(depth), ())
        weight = torch.stack(tuple(local.F))
        assert (weight[:, ~decided.survives] == 0).all() and torch.isfinite(weight).all()
        assert (weight[:, decided.survives] > 0).any(0).float().mean() > 0.9


def recorded(adjoint: rb.AdjointStrategy, asked: str):
    """The record of a box with lights that are selected by place, and of these a derivative by a parameter."""
    scene = closed_box({"type": "roughconductor"}, lamps=8)
    scene.get_parameter(asked).requires_grad_()
    call = rb.Renderer(scene, **SETTINGS, adjoint=adjoint, terms=()).prepare(0, None, SETTINGS["spp"], None)
    return record_wavefront(call, call.integrand, call.wavefronts[0])


def test_of_states_that_are_not_replayed_from_only_what_is_read_is_kept():
    """Strategies agree, which tests/adjoint/test_oracle.py holds, so that nothing is missing."""
    still, moving, replayed = (recorded(adjoint, asked) for adjoint, asked in (
        (rb.MemoizedAdjoint(), "thing.bsdf.alpha.value"), (rb.MemoizedAdjoint(), "thing.to_world"),
        (rb.MemoizedAdjoint(2), "thing.bsdf.alpha.value")))
    for record, origin, whole in ((still, False, False), (moving, True, False), (replayed, True, True)):
        assert len(record.states) > 1 and record.key is not None
        for state in record.states.values():
            assert (state.ray.o is not None) == origin
            assert (state.key is not None) == (state.vantage is not None) == whole


def test_nothing_of_a_chunk_is_held_once_it_is_added_to_the_image(monkeypatch):
    """But for what the backward pass needs: without a gradient, that is nothing."""
    alive, most = weakref.WeakSet(), []
    deposit = Films.deposit

    def watched(films, call, wavefront, values, samples):
        alive.add(values[0])
        most.append(len(alive))
        return deposit(films, call, wavefront, values, samples)

    monkeypatch.setattr(Films, "deposit", watched)
    scene = cornell()
    parameters(scene, ["white.reflectance.value"])
    image = rb.Renderer(scene, **SETTINGS, chunk=16, adjoint=rb.MemoizedAdjoint())(seed=1)
    assert image.requires_grad and len(most) == 8
    assert max(most) <= torch.get_num_threads()
