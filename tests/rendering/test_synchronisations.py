"""How often a rendering on a GPU exchanges something with the host: twice a bounce for numbers of lanes, and little else.

A bounce asks for the numbers of lanes in its queues, and for those that survive it. A tree of lights asks for the lanes that
meet one, and materials with another appearance on their backs for the lanes that may see these. Networks in the place of
textures ask for the numbers of lanes of each, forwards and backwards, and for the range of the values of each, which is
checked.
"""

from __future__ import annotations

from collections import Counter

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.gradients import cotangent
from tests.rendering.host import exchanges
from tests.scenes.closed_box import closed_box
from tests.scenes.networks import room
from torch_radbp.adjoint.function import RenderFunction

SHALLOW, DEEP = 2, 3

SCENES = {  # with the exchanges of a bounce
    "one material": (lambda: closed_box({"type": "twosided", "bsdf": {"type": "diffuse"}}), 2),
    "two materials": (lambda: closed_box({"type": "roughconductor"}), 2),
    "other backs": (lambda: closed_box({"type": "twosided", "front": {"type": "diffuse"},
                                        "back": {"type": "roughconductor"}}), 3),
    "many lights": (lambda: closed_box({"type": "roughconductor"}, lamps=8), 3),
    "networks": (room, 7),
}


@pytest.fixture(autouse=True)
def no_memory_is_asked_for(monkeypatch):
    monkeypatch.setattr("torch_radbp.rendering.cost.memory_of", lambda device: float("inf"))


def of_second_call(scene: rb.Scene, depth: int) -> Counter:
    """What is exchanged in the second rendering and backward pass of a scene, of which the first is forgotten."""
    renderer = rb.Renderer(scene, spp=2, max_depth=depth, rr_depth=100, caster="brute", compile=False,
                           share_samples=True)

    def render() -> None:
        image = renderer(seed=1)
        with torch.no_grad():  # as autograd's engine does, by which it would leave the mode
            RenderFunction.backward(image.grad_fn, cotangent(image.detach()))

    exchanges(render)
    return exchanges(render)


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")
@pytest.mark.parametrize("name", deep_but(["other backs", "many lights", "networks"], SCENES))
def test_a_bounce_asks_the_device_for_the_numbers_of_lanes_only(name):
    make, allowed = SCENES[name]
    scene = make()
    for parameter, value in scene.named_parameters():
        if parameter.endswith(("reflectance.value", "alpha.value")) or "module" in parameter:
            value.requires_grad_()
    shallow, deep = of_second_call(scene, SHALLOW), of_second_call(scene, DEEP)
    more = {what: count - shallow[what] for what, count in deep.items() if count > shallow[what]}
    assert 0 < sum(more.values()) <= allowed * (DEEP - SHALLOW), more
    assert not any(direction == "from the host" for direction, _ in more), more


def test_a_call_with_a_scene_as_it_was_asks_little():
    """Whether tensors are as they were, parameters in their domains, the image and the gradients finite."""
    scene = closed_box({"type": "roughconductor"})
    scene.get_parameter("thing.bsdf.alpha.value").requires_grad_()
    counted = of_second_call(scene, SHALLOW)
    of_bounces = ("jit/recording/any_device.py", "tensors/partition.py")
    bounces = {what: count for what, count in counted.items() if any(file in what[1] for file in of_bounces)}
    assert 0 < sum(bounces.values()) <= 2 * SHALLOW
    assert sum((counted - Counter(bounces)).values()) <= 8, counted


def test_exchanges_are_found():
    x = torch.arange(6.0)
    assert sum(exchanges(lambda: x[x > 2]).values()) == 1
    assert sum(exchanges(lambda: float(x.sum())).values()) == 1
    assert sum(exchanges(lambda: x.tolist()).values()) == 1
    assert sum(exchanges(lambda: torch.tensor(3.0, device=x.device)).values()) == 1
    assert not exchanges(lambda: x.new_zeros(3) + x[:3] * torch.full((), 2.0, device=x.device))


def test_what_the_host_has_fetched_it_does_not_ask_for():
    x, found = torch.arange(6.0), []

    def ask() -> None:
        of_host = x.cpu()
        there = of_host[of_host > 2] + torch.arange(3, device=of_host.device)
        back = there.to(x.device)
        found.extend([of_host.device.type, there.device.type, back.device.type, there.tolist(), back.tolist()])

    assert sum(exchanges(ask).values()) == 2  # for x, and for what has been sent back
    assert found == ["cpu", "cpu", "cuda", [3.0, 5.0, 7.0], [3.0, 5.0, 7.0]]
