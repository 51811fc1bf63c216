"""Products with one Jacobian share what does not depend on what it is multiplied with, and stay what they are alone."""

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrize

import torch_radbp as rb
from torch_radbp.adjoint import rendered
from torch_radbp.boundary.terms import shadows
from torch_radbp.optim.linearisation import Linearisation

SPP, DEPTH = 4, 3


computed: list[torch.Tensor] = []  # the motions of which poses have been computed


class Motion(nn.Module):
    """Poses by (2, 3): radians about the world's axes, and a translation."""

    def __init__(self, base: torch.Tensor):
        super().__init__()
        self.base = base

    def forward(self, motion: torch.Tensor) -> torch.Tensor:
        computed.append(motion)
        return rb.se3(motion[0], motion[1]) @ self.base

    def right_inverse(self, pose: torch.Tensor) -> torch.Tensor:
        return pose.new_zeros(2, 3)


def block_over_floor() -> tuple[rb.Renderer, list[torch.Tensor]]:
    """A turned block under a lamp, whose shadow lies on a floor; the numbers of its pose and of the floor's colour."""
    up = rb.look_at([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]).double()
    size = torch.diag(torch.tensor([0.4, 0.3, 0.5, 1.0], dtype=torch.float64))
    lamp = torch.eye(4, dtype=torch.float64)
    lamp[1, 3] = 4.0
    scene = rb.load_dict({
        "type": "scene", "sensor": {
            "type": "perspective", "fov": 50, "to_world": rb.look_at([0.0, 3.0, 4.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4}},
        "floor": {"type": "rectangle", "to_world": up @ (3 * torch.eye(4, dtype=torch.float64)).clone().index_put_(
            (torch.tensor(3), torch.tensor(3)), torch.tensor(1.0, dtype=torch.float64)),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3, 0.5, 0.7]}}},
        "block": {"type": "cube", "to_world": rb.se3(torch.tensor([0.4, 0.5, 0.1], dtype=torch.float64), torch.tensor(
            [0.1, 1.0, 0.0], dtype=torch.float64)) @ size, "bsdf": {"type": "diffuse"}},
        "lamp": {"type": "sphere", "radius": 0.3, "center": [0.5, 4.0, 0.3], "emitter": {
            "type": "area", "radiance": {"type": "rgb", "value": [20.0, 18.0, 15.0]}}}}).double()
    parametrize.register_parametrization(scene.block, "to_world", Motion(scene.block.to_world.detach().clone()))
    renderer = rb.Renderer(scene, spp=SPP, max_depth=DEPTH)
    return renderer, [scene.block.parametrizations.to_world.original,
                      scene.get_parameter("floor.bsdf.reflectance.value")]


def linearised(renderer: rb.Renderer, held: list[torch.Tensor]) -> Linearisation:
    return Linearisation(lambda seed, spp: renderer(seed=seed, spp=spp), held)


def directions(size: int, count: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(size)
    return [torch.randn(size, generator=generator, dtype=torch.float64) for _ in range(count)]


def test_products_that_share_are_those_alone_bit_by_bit_and_transposes():
    renderer, held = block_over_floor()
    linear = linearised(renderer, held)
    rows = len(linear.values(0, SPP))
    forward, backward = directions(linear.size, 3), directions(rows, 3)
    alone = [(linear.forward(v, 1, SPP), linear.backward(w, 1, SPP)) for v, w in zip(forward, backward)]
    assert all(part.isfinite().all() and part.abs().max() > 1e-3 for pair in alone for part in pair)
    with linear.sharing():
        for v, w, (expected, of_backward) in zip(forward, backward, alone):
            assert torch.equal(linear.backward(w, 1, SPP), of_backward)
            assert torch.equal(linear.forward(v, 1, SPP), expected)
            assert float(w @ expected) == pytest.approx(float(of_backward @ v), rel=1e-10)


def test_products_that_share_are_those_of_the_tape():
    """J^T w for w of all images, of both signs; by these also J v, whose products with w are those of v with J^T w."""
    renderer, held = block_over_floor()
    linear, tape = linearised(renderer, held), rb.Renderer(
        renderer.scene, spp=SPP, max_depth=DEPTH, adjoint=rb.TapeAdjoint())
    for parameter in held:
        parameter.requires_grad_()
    image = tape(seed=3)
    backward, forward = directions(image.numel(), 8), directions(linear.size, 2)
    taped = [torch.cat([part.reshape(-1) for part in torch.autograd.grad(image, held, w.view_as(image), retain_graph=True)])
             for w in backward]
    assert torch.stack(taped).isfinite().all() and torch.stack(taped).abs().amax(0).min() > 1e-3
    with linear.sharing():
        for w, expected in zip(backward, taped):
            assert (linear.backward(w, 3, SPP) - expected).norm() <= 1e-10 * expected.norm()
        for v in forward:
            found = linear.forward(v, 3, SPP)
            for w, expected in zip(backward, taped):
                assert abs(w @ found - v @ expected) <= 1e-10 * v.norm() * expected.norm()


def test_other_values_seeds_and_samples_are_not_taken_for_the_same():
    renderer, held = block_over_floor()
    linear = linearised(renderer, held)
    v, = directions(linear.size, 1)
    w, = directions(len(linear.values(0, SPP)), 1)
    start = linear.position()
    asked = [(start, 1, 4), (start, 2, 4), (start, 2, 8), (start + 0.02, 2, 8)]

    def products(position: torch.Tensor, seed: int, spp: int) -> tuple[torch.Tensor, torch.Tensor]:
        linear.move_to(position)
        return linear.forward(v, seed, spp), linear.backward(w, seed, spp)

    alone = [products(*each) for each in asked]
    alone.append(alone[0])
    with linear.sharing():
        shared = [products(*each) for each in [*asked, asked[0]]]
    assert all(torch.equal(a, b) for one, other in zip(alone, shared) for a, b in zip(one, other))
    assert all(not torch.equal(alone[number][0], alone[number + 1][0]) for number in range(4))


def test_what_a_function_changes_between_renderings_by_one_seed_counts():
    """Images of a scene by two colours of its block, which are no parameters of J: each has its own image and borders."""
    renderer, held = block_over_floor()
    colour = renderer.scene.get_parameter("block.bsdf.reflectance.value")

    def images(seed: int, spp: int | None) -> list[torch.Tensor]:
        found = []
        for value in (0.2, 0.8):
            with torch.no_grad():
                colour.fill_(value)
            image = renderer(seed=seed, spp=spp)
            found.append(image * image)
        return found

    linear = Linearisation(images, held)
    one, two = directions(linear.size, 2)
    alone = [linear.forward(v, 1, SPP) for v in (one, two)]
    assert not torch.equal(*alone[0].chunk(2))
    with linear.sharing():
        assert all(torch.equal(linear.forward(v, 1, SPP), expected) for v, expected in zip((one, two), alone))


def test_a_jacobian_looks_for_borders_once(monkeypatch: pytest.MonkeyPatch):
    """And renders the image twice: for the six columns of the motion, and, by other settings, for those of the colour."""
    renderer, held = block_over_floor()
    linear, calls = linearised(renderer, held), []
    whole = torch.stack([linear.forward(direction, 1, SPP) for direction in torch.eye(linear.size, dtype=torch.float64)], 1)
    for module, name in ((rendered, "render_detached"), (shadows, "samples_of_view")):
        made = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given, made=made, name=name: calls.append(name) or made(*given))
    computed.clear()
    assert torch.equal(linear.jacobian(1, SPP), whole)
    assert sorted(calls) == ["render_detached", "render_detached", "samples_of_view"]
    assert len(computed) <= 2 * linear.size


def test_a_parametrisation_is_computed_once_for_an_image():
    """It was three times: to check its values, for the tables, and to see what moves."""
    renderer, _ = block_over_floor()
    with torch.no_grad():
        for seed in range(2):  # the first ones find out what there is
            renderer(seed=seed)
        computed.clear()
        renderer(seed=2)
    assert len(computed) == 1
