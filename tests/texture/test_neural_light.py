"""Modules as the light of surfaces: what they send, and the derivatives of their parameters and places."""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import MEMOIZED, QUADRATIC, SOME, assert_informative, cotangent, image_and_gradients, relative_error
from tests.scenes import load, rectangle, rgb, sensor
from tests.scenes.networks import WHITE, Function, bright, lit_room, mlp, shining

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
TOLERANCE = 1e-10
SETTINGS = {"spp": 2, "max_depth": 4, "rr_depth": 2}
MOVING = ("lamp.to_world", "floor.to_world", "ball.to_world")


def weights(scene: rb.Scene) -> list[str]:
    return [name for name, _ in scene.named_parameters() if "radiance.module" in name]


WEIGHTS = weights(lit_room())


def image_of(scene: rb.Scene, **settings) -> torch.Tensor:
    with torch.no_grad():
        return rb.render(scene, **settings)


def test_the_weights_of_both_lamps_are_trained():
    assert len(WEIGHTS) == 8 and all(lit_room().get_parameter(name).requires_grad for name in WEIGHTS)


PICKED = {"uniform": {}, "tree": {"light_choice": "tree"}, "without light samples": {"nee": False},
          "attached": {"sampling": "attached"}}
QUICK = (("uniform", "area"), ("tree", "directionalarea"), ("without light samples", "area"),
         ("attached", "directionalarea"))


@pytest.mark.parametrize("name, kind", [(name, kind) if (name, kind) in QUICK else deep(name, kind)
                                        for name in PICKED for kind in ("area", "directionalarea")])
def test_a_module_of_one_value_is_a_lamp_of_one_colour(name, kind):
    """Also among many lamps: the tree knows how bright it is."""
    settings = PICKED[name]

    def constant(place):
        return torch.tensor([4.0, 5.0, 6.0], dtype=place.dtype).expand(len(place), 3)

    lamps = 12 if "light_choice" in settings else 1
    colours = lit_room(rgb(4, 5, 6), rgb(4, 5, 6), kind, lamps)
    module = Function(constant)
    modules = lit_room(rb.NeuralTexture(module), rb.NeuralTexture(module, of="position"), kind, lamps)
    expected = image_of(colours, spp=8, max_depth=4, **settings)
    assert (expected > 0).any()
    assert relative_error(image_of(modules, spp=8, max_depth=4, **settings), expected) < 1e-12


@pytest.mark.parametrize("light_choice", ["uniform", deep("tree")])
def test_a_module_that_computes_a_bitmap_looks_like_it(light_choice):
    def ramp(uv):
        return torch.stack([4 * uv[:, 0], 4 * uv[:, 1], 0 * uv[:, 0] + 1], 1)

    x = (torch.arange(256) + 0.5) / 256
    data = torch.stack([4 * x.expand(256, 256), 4 * x[:, None].expand(256, 256), torch.ones(256, 256)], 2)
    bitmap = {"type": "bitmap", "data": data, "wrap_mode": "clamp", "raw": True}
    settings = {"spp": 8, "max_depth": 3, "light_choice": light_choice}
    expected = image_of(lit_room(bitmap, rgb(1, 1, 1)), **settings)
    found = image_of(lit_room(rb.NeuralTexture(Function(ramp)), rgb(1, 1, 1)), **settings)
    dark = image_of(lit_room(rgb(0, 0, 0), rgb(1, 1, 1)), **settings)
    assert relative_error(dark, expected) > 0.1  # the lamp matters
    assert relative_error(found, expected) < (1e-2 if light_choice == "tree" else 1e-5)  # means over points differ a little


def test_lamps_of_modules_and_of_tables_light_the_scene_side_by_side():
    """Light adds up: both lamps together send what each sends alone."""
    settings = {"spp": 4, "max_depth": 3, "rr_depth": 100, "light_choice": "uniform"}
    both = image_of(lit_room(other=rgb(1, 2, 3)), **settings)
    first, second = lit_room(other=rgb(0, 0, 0)), lit_room(rgb(0, 0, 0), rgb(1, 2, 3))
    alone = [image_of(first, **settings), image_of(second, **settings)]
    assert relative_error(sum(alone), both) < 1e-12 and all(float(image.max()) > 0 for image in alone)


GEOMETRY = [*WEIGHTS, *MOVING]


@pytest.mark.parametrize("names, sampling, compile", [
    (WEIGHTS, "hybrid", False), deep(WEIGHTS, "hybrid", True), (GEOMETRY, "attached", True), deep(GEOMETRY, "hybrid", True),
    deep(GEOMETRY, "hybrid", False), *(deep(WEIGHTS, "attached", compile) for compile in (False, True)),
    deep(GEOMETRY, "attached", False)], ids=lambda value: "" if isinstance(value, list) else str(value))
def test_every_strategy_gives_the_gradient_of_the_tape(names, sampling, compile):
    settings = SETTINGS | {"sampling": sampling}
    reference, expected = image_and_gradients(lit_room(), names, adjoint=rb.TapeAdjoint(), **settings)
    assert_informative(reference, expected)
    few, every = (MEMOIZED[0], MEMOIZED[-1], QUADRATIC[0]), [*MEMOIZED, *QUADRATIC, rb.ReplayAdjoint()]
    every = SOME if sampling == "hybrid" else every
    for adjoint in few if compile or len(names) > len(WEIGHTS) else every:
        image, gradients = image_and_gradients(lit_room(), names, adjoint=adjoint, compile=compile, **settings)
        assert relative_error(image, reference) < TOLERANCE
        for name, gradient, wanted in zip(names, gradients, expected):
            assert relative_error(gradient, wanted) < TOLERANCE, (adjoint, name)


@pytest.mark.parametrize("sampling", [deep("hybrid"), "attached"])
def test_forward_mode_is_the_transpose_of_backward(sampling):
    names, generator = [*WEIGHTS, *MOVING], torch.Generator().manual_seed(0)
    tangents = {name: torch.randn(lit_room().get_parameter(name).shape, generator=generator, dtype=torch.float64)
                for name in names}
    for name in MOVING:
        tangents[name][3] = 0
    derivative = rb.jvp(lit_room(), tangents, seed=3, sampling=sampling, **SETTINGS)
    adj_image = cotangent(derivative)
    _, gradients = image_and_gradients(lit_room(), names, adj_image=adj_image, sampling=sampling, **SETTINGS)
    terms = torch.stack([(tangents[name] * gradient).sum() for name, gradient in zip(names, gradients)])
    assert abs(terms.sum() - (adj_image * derivative).sum()) < TOLERANCE * terms.abs().sum()


def test_weights_against_finite_differences():
    """Of the image at one seed, in which no decision depends on the brightness of two lamps."""
    settings = {"spp": 4, "max_depth": 3, "rr_depth": 100, "seed": 3, "share_samples": True}
    generator, scene = torch.Generator().manual_seed(0), lit_room()
    tangents = {name: torch.randn(scene.get_parameter(name).shape, generator=generator, dtype=torch.float64)
                for name in WEIGHTS}
    adj_image = cotangent(rb.render(scene, **settings).detach())

    def loss(step):
        moved = lit_room()
        with torch.no_grad():
            for name, tangent in tangents.items():
                moved.get_parameter(name).add_(step * tangent)
            return (rb.render(moved, **settings) * adj_image).sum()

    _, gradients = image_and_gradients(scene, WEIGHTS, adj_image=adj_image, **settings)
    expected = (loss(1e-6) - loss(-1e-6)) / 2e-6
    found = sum((tangents[name] * gradient).sum() for name, gradient in zip(WEIGHTS, gradients))
    assert abs(expected) > 1e-3 and abs(found - expected) < 1e-7 * abs(expected)


@pytest.mark.parametrize("of", ["uv", "position"])
def test_the_pose_of_a_lamp_against_finite_differences(of):
    """The lamp fills the view, and nothing but its light depends on where it is."""
    scene = load(sensor=sensor(3, (0.1, 0.2, 2)), lamp=rectangle((0, 0, 0), 2.0, bsdf=WHITE, emitter=shining(
        rb.NeuralTexture(bright(2 if of == "uv" else 3, 4), of))))
    tangent = torch.zeros(4, 4, dtype=torch.float64)
    tangent[:3] = torch.randn(3, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    adj_image = cotangent(rb.render(scene, spp=2, max_depth=1))

    def loss(step):
        with torch.no_grad():
            scene.lamp.to_world.add_(step * tangent)
            value = (rb.render(scene, spp=2, max_depth=1) * adj_image).sum()
            scene.lamp.to_world.sub_(step * tangent)
        return value

    expected = (loss(1e-6) - loss(-1e-6)) / 2e-6
    _, (gradient,) = image_and_gradients(scene, ["lamp.to_world"], seed=0, adj_image=adj_image, spp=2, max_depth=1,
                                          share_samples=True)
    assert abs(expected) > 1e-3 and abs((tangent * gradient).sum() - expected) < 1e-6 * abs(expected)


def test_only_paths_that_meet_or_pick_a_lamp_run_its_module():
    scene, places = lit_room(other=rgb(1, 1, 1)), []
    scene.lamp.emitter.radiance.module.register_forward_hook(lambda module, given, values: places.append(len(given[0])))
    with torch.no_grad():
        rb.render(scene, spp=4, max_depth=2, light_choice="uniform")
    assert 0 < sum(places) < 2 * 100  # of 100 paths, at the first bounce and the second


def test_light_that_is_not_in_its_range_names_the_texture():
    with pytest.raises(ValueError, match="lamp.emitter.radiance"):
        rb.render(lit_room(rb.NeuralTexture(Function(lambda uv: uv[:, :1] - 3.0))), spp=1)


@pytest.mark.parametrize("emitter", [{"type": "point", "position": [0, 1, 0], "intensity": mlp(2, 3)},
                                     {"type": "projector", "irradiance": mlp(2, 3)},
                                     {"type": "constant", "radiance": mlp(2, 3)}], ids=["point", "projector", "constant"])
def test_lights_that_are_on_no_surface_refuse_modules(emitter):
    with pytest.raises(rb.SceneError, match="of a light on a surface, only|module|number|colour"):
        load(sensor=sensor(), lamp=emitter)
