"""What a call on a GPU presumes of its scene: it waits once then, and finds out if that was wrong.

No GPU is needed, see `benchmarks.launches`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import pytest
import torch

import torch_radbp as rb
from benchmarks.launches import Card, card
from tests.gradients import unwarned_renderer
from tests.rendering.host import exchanges
from tests.scenes import diffuse, load, rectangle
from tests.scenes.mirrors import VIEWED

pytest.importorskip("warp")
ALBEDO, POSE, SKY = "floor.bsdf.reflectance.value", "plate.to_world", "sky.data"


@pytest.fixture(scope="module")
def device() -> Iterator[Card]:
    with card() as made:
        yield made


def plates() -> rb.Scene:
    """A plate over a floor under a sky, and a far plane behind both."""
    sky = {"type": "envmap", "bitmap": torch.full((3, 6, 3), 0.7)}
    floor, plate = (rectangle((0, 0, z), size, bsdf=diffuse(*rgb)) for z, size, rgb in (
        (0.0, 3.0, (0.6, 0.5, 0.4)), (0.5, 0.6, (0.2, 0.5, 0.8))))
    return load(torch.float32, sensor=VIEWED | {"far_clip": 40.0}, floor=floor, plate=plate, sky=sky)


def rendered(renderer: rb.Renderer) -> tuple[torch.Tensor, int]:
    """An image, and how often the host has waited."""
    held: list[torch.Tensor] = []
    found = exchanges(lambda: held.append(renderer(seed=1)))
    return held[0].detach(), sum(count for (way, _), count in found.items() if way == "to the host")


class Change(NamedTuple):
    """Something that is written into a parameter."""

    name: str
    differentiated: bool
    write: Callable[[torch.Tensor], object]
    waits: int | None  # of the call afterwards; None: it finds that it was mistaken


def moved(distance: float, axis: int = 2) -> Callable[[torch.Tensor], object]:
    return lambda pose: pose[axis, 3].add_(distance)


CHANGES = {
    "nothing": Change(ALBEDO, True, lambda value: None, 1),
    "a colour": Change(ALBEDO, True, lambda value: value.mul_(0.5), 1),
    "a colour that is not differentiated": Change(ALBEDO, False, lambda value: value.mul_(0.5), 8),
    "a colour past torch": Change(ALBEDO, True, lambda value: value.data.mul_(0.5), 1),
    "a colour past torch that is not differentiated": Change(ALBEDO, False, lambda value: value.data.mul_(0.5), None),
    "a pose": Change(POSE, True, moved(0.3), 2),  # before triangles that move get a new caster, too
    "a pose past torch": Change(POSE, True, lambda pose: moved(0.3)(pose.data), None),
    "a pose that stays": Change(POSE, True, lambda pose: None, 1),
    "a pose beyond the far plane": Change(POSE, True, moved(60.0, axis=1), None),
    "a sky": Change(SKY, True, lambda data: data.mul_(0.5), 1),
    "a sky that goes black": Change(SKY, True, lambda data: data.zero_(), None),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_written_into_a_parameter_is_rendered(name, device):
    change, scene = CHANGES[name], plates().requires_grad_(False)
    value = scene.get_parameter(change.name).requires_grad_(change.differentiated)
    settings = {"spp": 4, "max_depth": 3, "caster": "warp", "terms": ("interior",)}
    renderer = unwarned_renderer(scene, **settings)
    renderer(seed=1)  # makes what asks where tensors truly lie
    before = [rendered(renderer) for _ in range(3)][-1]
    assert before[1] == 1 and before[0].std() > 0
    caster = renderer.last_caster
    with torch.no_grad():
        change.write(value)
    expected = unwarned_renderer(scene, **settings)(seed=1).detach()
    image, waits = rendered(renderer)
    assert renderer.presumptions.mistaken == (change.waits is None) and (change.waits is None or waits == change.waits)
    stays = name in ("nothing", "a pose that stays")
    assert torch.equal(image, expected) and torch.equal(image, before[0]) == stays
    assert (renderer.last_caster is caster) == (change.name != POSE or stays)  # a tree lasts as long as nothing moves
    assert torch.equal(rendered(renderer)[0], image)


@pytest.mark.parametrize("name", [ALBEDO, POSE])
def test_a_parameter_that_is_no_number_is_named(name, device):
    scene = plates().requires_grad_(False)
    value = scene.get_parameter(name).requires_grad_()
    renderer = unwarned_renderer(scene, spp=4, max_depth=3, caster="warp", terms=("interior",))
    renderer(seed=1)
    for _ in range(2):
        rendered(renderer)
    with torch.no_grad():
        value.fill_(torch.nan)
    for _ in range(2):  # it is not taken for checked
        with pytest.raises(ValueError, match=f"{name}.* NaN or infinite"):
            rendered(renderer)
