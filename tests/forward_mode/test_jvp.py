"""Forward mode against the backward pass: <tangent, vjp(w)> = <w, jvp(tangent)>, at one seed, in float64."""

import pytest
import torch
from torch.autograd import forward_ad
from torch.func import functional_call

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import relative_error, unwarned_renderer
from tests.scenes import CASES, load, parameters, rectangle, rgb, sensor, texels
from tests.scenes.lights import EMITTERS, scene_of
from tests.scenes.materials import MATERIALS

TOLERANCE = 1e-9  # sums of a million roundings of 1e-16
SETTINGS = {"spp": 4, "max_depth": 4, "rr_depth": 2, "compile": False}  # as forward mode is


def tangents_of(scene, names, seed=0):
    """Numbers of both signs in the shapes of the parameters."""
    generator = torch.Generator().manual_seed(seed)
    return {name: torch.randn(scene.get_parameter(name).shape, generator=generator, dtype=torch.float64)
            for name in names}


def cotangents_of(image):
    """Constant, the image itself, and noise."""
    generator = torch.Generator().manual_seed(1)
    return [torch.ones_like(image), image, torch.randn(image.shape, generator=generator, dtype=torch.float64)]


def assert_transposed(build, names, seed=3, **settings):
    """The derivative image along one tangent per parameter is the transpose of the backward pass."""
    tangents = tangents_of(build(), names)
    derivative = rb.jvp(build(), tangents, seed=seed, **settings)
    assert derivative.shape[:2] == (1, 3) and not derivative.requires_grad
    assert torch.isfinite(derivative).all() and derivative.abs().max() > 0
    scene = build()
    wanted = parameters(scene, names)
    image = unwarned_renderer(scene, **settings)(seed=seed)
    for w in cotangents_of(derivative):
        gradients = torch.autograd.grad(image, wanted, w, retain_graph=True)
        terms = torch.stack([(tangents[name] * gradient).sum() for name, gradient in zip(names, gradients)])
        scale = terms.abs().sum()
        assert abs(terms.sum() - (w * derivative).sum()) < TOLERANCE * scale
        assert (terms.abs() > 100 * TOLERANCE * scale).all()  # one that forward or backward leaves out is seen


@pytest.mark.parametrize("settings", [{}, {"nee": False, "spp": 256}, {"hide_emitters": True, "spp": 16},
                                      {"max_depth": -1, "rr_depth": 1}, {"chunk": 100, "adjoint": rb.MemoizedAdjoint("log")},
                                      {"memory_budget": "1GiB"}], ids=str)
def test_the_cornell_box_forward_is_the_transpose_of_backward(settings):
    assert_transposed(CASES["cornell"].scene, CASES["cornell"].parameters, **SETTINGS | settings)


ACROSS = {"repeat_bilinear", "mirror_nearest", "clamp_trilinear"}  # every way to wrap and to filter once
OTHERS = [name for name in CASES if name != "cornell"]
QUICK = [name for name in OTHERS if name in ACROSS or CASES[name].build is not CASES["repeat_bilinear"].build]


@pytest.mark.parametrize("name", deep_but(QUICK, OTHERS))
@pytest.mark.parametrize("nee", [True, False], ids=["nee", "no_nee"])
def test_forward_is_the_transpose_of_backward_in(name, nee):
    case = CASES[name]
    # Without next-event estimation nothing finds a point light.
    names = [p for p in case.parameters if nee or not p.endswith("intensity.value")]
    assert_transposed(case.scene, names, **SETTINGS | {"nee": nee, "spp": 4 if nee else 64})


def derived(scene):
    """The parameters that set textures."""
    return [name for name, _ in scene.named_parameters() if name.rpartition(".")[2] in ("value", "data")]


def is_read(scene, name: str) -> bool:
    """Whether an image depends on a parameter: materials of many lobes read nothing of those that are absent."""
    scene.get_parameter(name).requires_grad_()
    owner = scene.get_submodule(name.split(".bsdf.")[0] + ".bsdf") if ".bsdf." in name else scene
    read = unwarned_renderer(scene, spp=1, max_depth=2, compile=False)(seed=1).requires_grad
    assert read or any(hasattr(module, "features") for module in owner.modules())
    return read


@pytest.mark.parametrize("kind", EMITTERS)
def test_forward_is_the_transpose_of_backward_under_an_emitter(kind):
    # The camera sees the floor: the lamps' own reflectance does not matter.
    names = [name for name in derived(scene_of(kind)) if "lamp" in name and "bsdf" not in name]
    assert names
    assert_transposed(lambda: scene_of(kind), names, **SETTINGS | {"spp": 16})


@pytest.mark.parametrize("kind", [  # every eighth, but of glass one
    kind if place % 8 == 0 and kind not in ("bubble beckmann", "glass with bumps") else deep(kind)
    for place, kind in enumerate(MATERIALS)])
def test_forward_is_the_transpose_of_backward_on_a_material(kind):
    def described(material):
        """A dict of a scene: nested materials are children with names of their own."""
        found = {}
        for key, value in material.items():
            if isinstance(value, list) and isinstance(value[0], dict):
                found |= {f"{key}_{number}": described(part) for number, part in enumerate(value)}
            elif isinstance(value, list) and len(value) == 3:
                found[key] = rgb(*value)
            elif key == "nested_texture":  # of a bump map, whose number stands for a slope
                found[key] = {"type": "bitmap", "bitmap": value * texels(4, 5, 3), "raw": True}
            else:
                found[key] = described(value) if isinstance(value, dict) else value
        return found

    def build():
        return load(sensor=sensor(8, (0, 0.5, 3.5), (0, 0, 0), 45),
                    ball={"type": "sphere", "radius": 0.7, "bsdf": described(MATERIALS[kind])},
                    floor=rectangle((0, -0.7, 0), 2.0, angle=-90),
                    sky={"type": "envmap", "bitmap": texels(5, 7, 2)})

    names = [name for name in derived(build()) if name.startswith("ball") and "k.value" not in name
             and is_read(build(), name)]
    if not names:
        pytest.skip("no parameter of this material has a derivative")
    assert_transposed(build, names, **SETTINGS | {"spp": 16})


def image_of(renderer, **values):
    return functional_call(renderer, {f"scene.{name}": value for name, value in values.items()}, kwargs={"seed": 3})


@pytest.mark.parametrize("settings", [{}, {"chunk": 64}, {"compile": True, "spp": 16}, {"adjoint": rb.TapeAdjoint()}],
                         ids=str)
def test_dual_parameters_and_torch_func_give_the_same_derivative(settings):
    case = CASES["textured_lamp"]
    settings = SETTINGS | settings
    scene = case.scene()
    tangents = tangents_of(scene, case.parameters)
    values = {name: scene.get_parameter(name).detach() for name in case.parameters}
    expected = rb.jvp(scene, tangents, seed=3, **settings)
    renderer = rb.Renderer(scene, **settings)
    primal = renderer(seed=3)
    assert expected.abs().max() > 0
    with forward_ad.dual_level():
        duals = {name: forward_ad.make_dual(value, tangents[name]) for name, value in values.items()}
        image, tangent = forward_ad.unpack_dual(image_of(renderer, **duals))
        assert torch.equal(image, primal) and torch.equal(tangent, expected)

    image, tangent = torch.func.jvp(
        lambda values: image_of(renderer, **{n: 2 * v for n, v in values.items()}),
        ({name: value / 2 for name, value in values.items()},), ({name: tangent / 2 for name, tangent in tangents.items()},))
    assert torch.equal(image, primal) and torch.equal(tangent, expected)
    assert not torch._C._functorch.is_functorch_wrapped_tensor(tangent)


def test_a_loss_of_the_image_is_differentiated_on_by_torch_func():
    case, name = CASES["cornell"], "green.reflectance.value"
    renderer = rb.Renderer(case.scene(), **SETTINGS)
    x, v = renderer.scene.get_parameter(name).detach(), torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
    loss, slope = torch.func.jvp(lambda x: (image_of(renderer, **{name: x}) ** 2).mean(), (x,), (v,))
    x.requires_grad_()
    backward = (image_of(renderer, **{name: x}) ** 2).mean()
    gradient, = torch.autograd.grad(backward, x)
    assert torch.equal(loss, backward.detach()) and abs(slope - (gradient * v).sum()) < TOLERANCE * slope.abs()


def test_a_rendering_of_constants_inside_torch_func_has_no_tangent():
    renderer = rb.Renderer(CASES["cornell"].scene(), **SETTINGS)
    image, tangent = torch.func.jvp(lambda x: renderer(seed=3) * x, (torch.tensor(2.0),), (torch.tensor(1.0),))
    assert torch.equal(image, 2 * renderer(seed=3)) and torch.equal(tangent, renderer(seed=3))


@pytest.fixture
def three_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    yield
    torch.set_num_threads(before)


def test_chunks_side_by_side_carry_tangents(three_threads):
    case = CASES["cornell"]
    tangents = tangents_of(case.scene(), case.parameters)
    side_by_side = rb.jvp(case.scene(), tangents, **SETTINGS | {"chunk": 50})
    torch.set_num_threads(1)
    expected = rb.jvp(case.scene(), tangents, **SETTINGS | {"chunk": 50})
    assert expected.abs().max() > 0 and torch.equal(side_by_side, expected)


def test_a_tangent_goes_through_a_parametrisation():
    class Square(torch.nn.Module):
        def forward(self, x):
            return x * x

        def right_inverse(self, y):
            return y.sqrt()

    scene, v = CASES["cornell"].scene(), torch.tensor([0.3, -1.0, 0.5], dtype=torch.float64)
    root = scene.get_parameter("white.reflectance.value").detach().sqrt()
    expected = rb.jvp(scene, {"white.reflectance.value": 2 * root * v}, **SETTINGS)
    torch.nn.utils.parametrize.register_parametrization(scene.get_submodule("white.reflectance"), "value", Square())
    derivative = rb.jvp(scene, {"white.reflectance.parametrizations.value.original": v}, **SETTINGS)
    assert expected.abs().max() > 0 and relative_error(derivative, expected) < 1e-12


def test_nothing_is_left_behind_and_gradients_that_others_want_do_not_matter():
    case = CASES["cornell"]
    scene = case.scene()
    expected = rb.jvp(scene, tangents_of(scene, case.parameters), **SETTINGS)
    wanted = parameters(scene, case.parameters)
    scene.get_parameter("floor.to_world").requires_grad_()
    assert torch.equal(rb.jvp(scene, tangents_of(scene, case.parameters), **SETTINGS), expected)
    assert all(p.requires_grad and p.grad is None for p in wanted)


def test_float32_and_several_sensors():
    two = {"sensor": sensor(6), "other": sensor(6, (0.5, 0.3, 3.2))}
    scene = CASES["cornell"].build(dtype=torch.float32, sensors=two)
    direction = {"white.reflectance.value": torch.ones(3, dtype=torch.float64)}
    both = rb.jvp(scene, direction, **SETTINGS)
    assert both.shape == (2, 3, 6, 6) and both.dtype == torch.float32
    assert torch.equal(rb.jvp(scene, direction, sensors=[1], **SETTINGS), both[1:])
    assert not torch.equal(both[0], both[1])


BAD = {
    "unknown": (AttributeError, {"whit.reflectance.value": torch.ones(3)}, "did you mean 'white.reflectance.value'"),
    "shape": (ValueError, {"white.reflectance.value": torch.ones(2)},
              r"tangent of 'white.reflectance.value' must have shape \(3,\), got \(2,\)"),
    "nan": (ValueError, {"white.reflectance.value": torch.tensor([1.0, float("nan"), 0])}, "must be finite, got 1 of 3"),
    "none": (ValueError, {}, "at least one parameter"),
    "no mapping": (TypeError, torch.ones(3), "must map names .* got Tensor"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_tangent_is_an_error_that_says_what_to_do(case):
    error, tangents, message = BAD[case]
    with pytest.raises(error, match=message):
        rb.jvp(CASES["cornell"].scene(), tangents, **SETTINGS)


@pytest.mark.parametrize("transform", [torch.func.grad, torch.func.jacfwd])
def test_other_transforms_of_torch_func_are_refused(transform):
    renderer, name = rb.Renderer(CASES["cornell"].scene(), **SETTINGS), "white.reflectance.value"
    with pytest.raises(RuntimeError, match="works in jvp only"):
        transform(lambda x: image_of(renderer, **{name: x}).sum())(renderer.scene.get_parameter(name).detach())
    assert renderer(seed=3).shape == (1, 3, 8, 8)


def test_both_modes_at_once_are_refused_but_for_the_tape():
    name = "white.reflectance.value"
    x = CASES["cornell"].scene().get_parameter(name).detach().requires_grad_()
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(x, torch.ones_like(x))
        with pytest.raises(RuntimeError, match="either forward or backward"):
            image_of(rb.Renderer(CASES["cornell"].scene(), **SETTINGS), **{name: dual})
        image = image_of(rb.Renderer(CASES["cornell"].scene(), adjoint=rb.TapeAdjoint(), **SETTINGS), **{name: dual})
        hessian, = torch.autograd.grad(forward_ad.unpack_dual(image).tangent.sum(), x)
    assert hessian.abs().max() > 0


def test_tangents_have_the_samples_of_seed_grad():
    renderer, name = rb.Renderer(CASES["cornell"].scene(), **SETTINGS), "white.reflectance.value"
    x = renderer.scene.get_parameter(name).detach()

    def dual(**seeds):
        return forward_ad.unpack_dual(functional_call(renderer, {f"scene.{name}": forward_ad.make_dual(x, x)}, kwargs=seeds))

    with forward_ad.dual_level():
        image, tangent = dual(seed=1, seed_grad=2)
        one, other = (dual(seed=seed, seed_grad=seed) for seed in (1, 2))
    assert torch.equal(image, one.primal) and torch.equal(tangent, other.tangent)
    assert not torch.equal(tangent, one.tangent)
