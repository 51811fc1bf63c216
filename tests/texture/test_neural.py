"""Textures that are modules: their values, and the derivatives of their parameters and places."""

import copy

import pytest
import torch
from torch import nn
from torch.func import functional_call

import torch_radbp as rb
from tests.allocated import allocated
from tests.deep import deep, deep_but_every
from tests.gradients import MEMOIZED, QUADRATIC, SOME, assert_informative, cotangent, image_and_gradients, relative_error
from tests.scenes import SKY, load, rectangle, sensor
from tests.scenes.networks import LAMP, mlp, room, textured
from tests.texture.slots import OTHERS, SLOTS, WHITE
from torch_radbp.io.values.transform import scale
from torch_radbp.jit.stages import compiled

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
TOLERANCE = 1e-10  # hundreds of lanes, each some hundred roundings of 1e-16
SETTINGS = {"spp": 2, "max_depth": 4, "rr_depth": 2}
MOVING = ("floor.to_world", "box.vertex_positions")


def weights(scene: rb.Scene) -> list[str]:
    """The names of all parameters of modules."""
    return [name for name, _ in scene.named_parameters() if ".module." in name]


WEIGHTS = weights(room())


def poster(bsdf: dict, size: int = 3, dtype: torch.dtype = torch.float64) -> rb.Scene:
    """A rectangle that fills the view under a sky."""
    return load(dtype, sensor=sensor(size, (0.2, 0.1, 2)), poster=rectangle((0, 0, 0), 2.0, bsdf=bsdf), sky=SKY)


def test_every_module_of_the_room_is_trained():
    assert len(WEIGHTS) == 16
    assert "floor.bsdf.reflectance.module.0.weight" in WEIGHTS and "ball.bsdf.alpha.module.2.bias" in WEIGHTS
    assert all(room().get_parameter(name).requires_grad for name in WEIGHTS)  # as their owner left them


def test_a_module_that_computes_a_bitmap_looks_like_it():
    """A constant, and coordinates themselves, against the textures that say the same."""
    class Ramp(nn.Module):
        def forward(self, uv):
            return torch.stack([uv[:, 0], uv[:, 1], 0 * uv[:, 0] + 0.25], 1)

    x = (torch.arange(256) + 0.5) / 256
    bitmap = torch.stack([x.expand(256, 256), x[:, None].expand(256, 256), torch.full((256, 256), 0.25)], 2)
    picture = {"type": "bitmap", "data": bitmap, "wrap_mode": "clamp"}
    expected = rb.render(poster({"type": "diffuse", "reflectance": picture}), spp=8, max_depth=2)
    image = rb.render(poster(textured(Ramp())), spp=8, max_depth=2)
    assert relative_error(image, expected) < 1e-6  # the bitmap is float32


GEOMETRY = [*WEIGHTS, *MOVING]


@pytest.mark.parametrize("names, sampling, compile", [
    (WEIGHTS, "hybrid", False), deep(WEIGHTS, "hybrid", True), (GEOMETRY, "attached", True), deep(GEOMETRY, "hybrid", True),
    deep(GEOMETRY, "hybrid", False), *(deep(WEIGHTS, "attached", compile) for compile in (False, True)),
    deep(GEOMETRY, "attached", False)], ids=lambda value: "" if isinstance(value, list) else str(value))
def test_every_strategy_gives_the_gradient_of_the_tape(names, sampling, compile):
    settings = SETTINGS | {"sampling": sampling}
    reference, expected = image_and_gradients(room(), names, adjoint=rb.TapeAdjoint(), **settings)
    assert_informative(reference, expected)
    few = (MEMOIZED[0], MEMOIZED[-1], QUADRATIC[0])
    every, plain = (*MEMOIZED, *QUADRATIC, rb.ReplayAdjoint()), names == WEIGHTS and sampling == "hybrid"
    for adjoint in few if not plain else every if compile else SOME:
        image, gradients = image_and_gradients(room(), names, adjoint=adjoint, compile=compile, **settings)
        assert relative_error(image, reference) < TOLERANCE
        for name, gradient, wanted in zip(names, gradients, expected):
            error = relative_error(gradient, wanted)
            assert error < TOLERANCE, f"{adjoint}, {name}: relative error {error:.1e}"


@pytest.mark.parametrize("names, sampling", [
    (WEIGHTS, "hybrid"), (GEOMETRY, "attached"), *(deep(WEIGHTS, sampling) for sampling in ("detached", "attached")),
    *(deep(GEOMETRY, sampling) for sampling in ("hybrid", "detached"))],
                         ids=lambda value: value if isinstance(value, str) else f"{len(value)} parameters")
def test_forward_mode_is_the_transpose_of_backward(names, sampling):
    generator = torch.Generator().manual_seed(0)
    tangents = {name: torch.randn(room().get_parameter(name).shape, generator=generator, dtype=torch.float64)
                for name in names}
    for name in tangents.keys() & {"floor.to_world"}:
        tangents[name][3] = 0
    derivative = rb.jvp(room(), tangents, seed=3, sampling=sampling, **SETTINGS)
    adj_image = cotangent(derivative)
    _, gradients = image_and_gradients(room(), names, adj_image=adj_image, sampling=sampling, **SETTINGS)
    terms = torch.stack([(tangents[name] * gradient).sum() for name, gradient in zip(names, gradients)])
    assert abs(terms.sum() - (adj_image * derivative).sum()) < TOLERANCE * terms.abs().sum()


def test_weights_against_finite_differences():
    """Of the image at one seed: directions follow the roughness, so that nothing is held."""
    settings = {"spp": 4, "max_depth": 3, "rr_depth": 100, "sampling": "attached", "seed": 3, "share_samples": True}
    generator = torch.Generator().manual_seed(0)
    tangents = {name: torch.randn(room().get_parameter(name).shape, generator=generator, dtype=torch.float64)
                for name in WEIGHTS}
    adj_image = cotangent(rb.render(room(), **settings))

    def loss(step):
        scene = room()
        with torch.no_grad():
            for name, tangent in tangents.items():
                scene.get_parameter(name).add_(step * tangent)
            return (rb.render(scene, **settings) * adj_image).sum()

    _, gradients = image_and_gradients(room(), WEIGHTS, adj_image=adj_image, **settings)
    expected = (loss(1e-6) - loss(-1e-6)) / 2e-6
    found = sum((tangents[name] * gradient).sum() for name, gradient in zip(WEIGHTS, gradients))
    assert abs(found - expected) < 1e-7 * abs(expected)


@pytest.mark.parametrize("of, moving", [("uv", "sensor.to_world"), ("position", "poster.to_world")])
def test_gradcheck_of_weights_and_of_what_moves_the_place(of, moving):
    """The camera sees nothing but the poster, whose edges are out of view: the image is smooth in its pose."""
    scene = poster(textured(mlp(2 if of == "uv" else 3, 3, width=2), of), size=2)
    renderer = rb.Renderer(scene, spp=1, max_depth=2, nee=False, sampling="attached", share_samples=True)
    names = [f"scene.{name}" for name in (*weights(renderer.scene), moving)]
    values = [dict(renderer.named_parameters())[name].detach().clone() for name in names]
    pose = values.pop()

    def image(*parameters):
        matrix = torch.cat([parameters[-1], pose[3:]])
        return functional_call(renderer, dict(zip(names, (*parameters[:-1], matrix))), kwargs={"seed": 1})

    inputs = [value.requires_grad_() for value in (*values, pose[:3].clone())]
    assert torch.autograd.gradcheck(image, inputs, eps=1e-6, atol=1e-7, fast_mode=True)


def test_only_lanes_that_meet_a_module_run_it():
    """Two modules in one queue: each is called on its own lanes, of one chunk at a time."""
    scene, calls = room(), {"floor": [], "wall": []}
    for name, places in calls.items():
        getattr(scene, name).bsdf.reflectance.module.register_forward_hook(
            lambda module, given, values, places=places: places.append(given[0]))
    with torch.no_grad():
        rb.render(scene, spp=4, max_depth=2, chunk=48)
    for places in calls.values():
        assert 1 < len(places) <= 3 and all(0 < len(place) < 48 for place in places)
        assert all(place.shape[1] == 2 for place in places)
    assert sum(len(place) for places in calls.values() for place in places) < 144  # paths, of which some meet metal


def bytes_at_peak(chunk: int, spp: int) -> int:
    """The most bytes that torch holds during a forward and backward pass through a wide network, over those before."""
    return allocated(rb.Renderer(poster(textured(mlp(2, 3, width=256)), 16), spp=spp, max_depth=2, chunk=chunk))


def test_the_chunk_bounds_the_memory_of_a_module():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        small, large, longer = bytes_at_peak(64, 4), bytes_at_peak(1024, 4), bytes_at_peak(64, 16)
    finally:
        torch.set_num_threads(threads)
    activations = 8 * 256  # bytes of a layer, a lane
    assert large - small > 2 * activations * (1024 - 64)
    # Four times the paths: what is kept of each is a state and a hit, and no activation.
    assert longer - small < 0.15 * activations * 3 * 1024


def test_results_do_not_depend_on_the_chunk_and_are_the_same_each_time():
    whole, expected = image_and_gradients(room(), WEIGHTS, **SETTINGS)
    image, first = image_and_gradients(room(), WEIGHTS, chunk=10, **SETTINGS)
    _, again = image_and_gradients(room(), WEIGHTS, chunk=10, **SETTINGS)
    assert torch.equal(image, whole) or relative_error(image, whole) < 1e-14
    for one, other, wanted in zip(first, again, expected):
        assert torch.equal(one, other) and relative_error(one, wanted) < 1e-12


def test_a_step_between_a_rendering_and_its_backward_pass_changes_nothing():
    scene, gradients = room(), []
    for step in (False, True):
        image = rb.render(scene, **SETTINGS)
        if step:
            with torch.no_grad():
                scene.floor.bsdf.reflectance.module[0].weight.mul_(2)
        image.sum().backward()
        gradients.append(scene.floor.bsdf.reflectance.module[0].weight.grad.clone())
    assert relative_error(gradients[1], 2 * gradients[0]) < 1e-14


def test_a_module_in_two_materials_adds_up_its_gradients():
    shared = mlp(2, 3)
    scene = load(sensor=sensor(6, (0, 1.2, 3), (0, -0.1, 0), 45), sky=SKY,
                 wall=rectangle((0, 0.3, -1), bsdf=textured(shared)),
                 floor=rectangle((0, -0.5, 0), 1.3, angle=-90, bsdf=textured(shared)))
    name, = (name for name in weights(scene) if name.endswith("2.bias"))
    _, expected = image_and_gradients(copy.deepcopy(scene), [name], adjoint=rb.TapeAdjoint(), **SETTINGS)
    _, gradients = image_and_gradients(scene, [name], **SETTINGS)
    assert relative_error(gradients[0], expected[0]) < TOLERANCE


def test_another_module_compiles_nothing():
    def functions():
        image_and_gradients(poster(textured(mlp(2, channels, width=width))), ["poster.bsdf.reflectance.module.0.bias"],
                            spp=1, compile=True)
        return [len(stage.fused.compiled) for stage in compiled()]

    channels, width = 3, 4
    first = functions()
    channels, width = 1, 7
    assert functions() == first


PARTNERS = {"alpha_u": {"alpha_v": 0.3}, "alpha_v": {"alpha_u": 0.3},
            "sheen_tint": {"sheen": 0.8, "base_color": {"type": "rgb", "value": [0.8, 0.3, 0.2]}},
            "spec_tint": {"spec_trans": 0.8}, "principledthin eta": {"spec_trans": 0.8},
            "principledthin anisotropic": {"spec_trans": 0.8}, "clearcoat_gloss": {"clearcoat": 1.0},
            "k": {"eta": 0.2}}  # by itself, with an index of 0, it turns the phase and reflects all


@pytest.mark.parametrize("compile", [False, deep(True)], ids=["eager", "compiled"])
@pytest.mark.parametrize("kind, name", deep_but_every(8, SLOTS))
def test_a_module_can_stand_in_every_slot_of_every_material(kind, name, compile):
    """On a ball in a room, with the gradient of the tape."""
    outputs = 1 if "alpha" in name or name in ("weight", "opacity") else 3

    def scene():
        bsdf = {"type": kind, name: rb.NeuralTexture(mlp(3, outputs, 5), of="position")} | OTHERS.get(kind, {})
        bsdf |= PARTNERS.get(name, PARTNERS.get(f"{kind} {name}", {}))
        ball = {"type": "sphere", "to_world": scale((0.6, 0.6, 0.6)), "bsdf": bsdf}
        return load(sensor=sensor(6), ball=ball, sky=SKY, lamp=rectangle((0, 0, 4), axis=(0, 1, 0), angle=180, emitter=LAMP),
                    floor=rectangle((0, -0.6, 0), 3.0, angle=-90, bsdf=WHITE))

    names = weights(scene())
    reference, expected = image_and_gradients(scene(), names, adjoint=rb.TapeAdjoint(), **SETTINGS)
    assert_informative(reference, expected)
    image, gradients = image_and_gradients(scene(), names, compile=compile, **SETTINGS)
    assert relative_error(image, reference) < TOLERANCE
    for gradient, wanted in zip(gradients, expected):
        assert relative_error(gradient, wanted) < TOLERANCE


@pytest.mark.parametrize("returned, error, message", [
    (lambda uv: uv, ValueError, r"'poster.bsdf.reflectance' must return shape \(\d+, 1\) or \(\d+, 3\)"),
    (lambda uv: uv[:, :1].float(), TypeError, "must return torch.float64 on cpu, as the scene is, got torch.float32"),
    (lambda uv: None, TypeError, "must return a tensor, got NoneType"),
    (lambda uv: uv[:, :1] - 1.5, ValueError, r"'poster.bsdf.reflectance' must be at least 0, got .*nn.Sigmoid"),
    (lambda uv: (uv[:, :1] - 9).log(), ValueError, "'poster.bsdf.reflectance' has .* values that are NaN"),
], ids=["shape", "dtype", "nothing", "range", "nan"])
def test_what_a_module_returns_is_checked(returned, error, message):
    class Wrong(nn.Module):
        def forward(self, uv):
            return returned(uv)

    with pytest.raises(error, match=message):
        rb.render(poster(textured(Wrong())), spp=1)


@pytest.mark.parametrize("make, message", [
    (lambda: rb.NeuralTexture(3), "must be an nn.Module"),
    (lambda: rb.NeuralTexture(rb.NeuralTexture(nn.Linear(2, 3))), "must be an nn.Module"),
    (lambda: rb.NeuralTexture(torch.jit.trace(nn.Linear(2, 3), torch.zeros(1, 2))), "must be plain torch"),
    (lambda: rb.NeuralTexture(torch.compile(nn.Linear(2, 3))), "must be plain torch, got OptimizedModule"),
    (lambda: rb.NeuralTexture(nn.Linear(2, 3), of="uvw"), "did you mean 'uv'"),
], ids=["number", "texture", "script", "compiled", "of"])
def test_what_is_no_module_is_refused(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make()


def test_where_it_cannot_stand_it_is_refused(tmp_path):
    with pytest.raises(rb.SceneError, match="irradiance of Projector must be a colour or a bitmap, got a NeuralTexture"):
        load(sensor=sensor(), lamp={"type": "projector", "irradiance": mlp(2, 3)})
    with pytest.raises(rb.SceneError, match="poster.bsdf.reflectance: a NeuralTexture cannot be written as XML"):
        rb.save(poster(textured(mlp(2, 3))), tmp_path / "scene.xml")
    assert not list(tmp_path.iterdir())


def test_a_scene_with_a_module_has_a_state():
    scene, other = room(), room()
    with torch.no_grad():
        other.floor.bsdf.reflectance.module[0].weight.zero_()
    assert not torch.equal(rb.render(other, spp=1), rb.render(scene, spp=1))
    other.load_state_dict(scene.state_dict())
    assert torch.equal(rb.render(other, spp=1), rb.render(scene, spp=1))
    assert torch.equal(rb.render(copy.deepcopy(scene), spp=1), rb.render(scene, spp=1))
