"""What a renderer, its scene and torch's modes are handed by mistake: one message each, never a wrong image."""

import copy
import io
import pickle
import re

import numpy as np
import pytest
import torch
from torch.func import functional_call

import torch_radbp as rb
from tests.scenes import cornell, diffuse, load, rectangle, sensor, textured

pytestmark = pytest.mark.hostile
NAN, INF = float("nan"), float("inf")
NAME = "floor.bsdf.reflectance.value"
GREY = torch.full((3,), 0.5)
IMAGE = torch.full((3, 2, 2), 0.5)
DENSE = "must be a dense tensor, got torch.sparse_coo: convert it with .to_dense()"
SETTINGS = {"spp": 2, "max_depth": 3}


def scene(dtype: torch.dtype = torch.float32) -> rb.Scene:
    return load(dtype, sensor=sensor(4), floor=rectangle((0, -0.5, 0), angle=-90, bsdf=diffuse(0.5, 0.5, 0.5)),
                sky={"type": "constant"})


def renderer(**settings) -> rb.Renderer:
    return rb.Renderer(scene(), **SETTINGS | settings)


def replaced(value, name: str = NAME):
    return functional_call(renderer(), {f"scene.{name}": value}, kwargs={"seed": 0})


CALLS = {
    "seed that is no number": ({"seed": NAN}, "seed must be an integer, got nan"),
    "fractional seed": ({"seed": 1.5}, "seed must be an integer, got 1.5"),
    "seed as truth": ({"seed": True}, "seed must be an integer, got True"),
    "several seeds": ({"seed": torch.tensor([1, 2])}, "seed must be an integer, got tensor([1, 2])"),
    "seed of 65 bits": ({"seed": 1 << 64}, "seed must be from -2**63 to 2**64 - 1, got 18446744073709551616"),
    "seed far below zero": ({"seed": -2**70}, "seed must be from -2**63 to 2**64 - 1, got -11805"),
    "seed of the backward pass as text": ({"seed_grad": "a"}, "seed_grad must be an integer, got 'a'"),
    "seed of the backward pass of 65 bits": ({"seed_grad": 1 << 64}, "seed_grad must be from -2**63 to 2**64 - 1"),
    "a set of sensors": ({"sensors": {0}}, "sensors: an index must be an integer, got {0}"),
    "a dict of sensors": ({"sensors": {"sensor": 1}}, "sensors: an index must be an integer, got {'sensor': 1}"),
    "nested sensors": ({"sensors": [[0]]}, "sensors: an index must be an integer, got [0]"),
    "a fractional sensor": ({"sensors": [0.0]}, "sensors: an index must be an integer, got 0.0"),
    "a sensor that is none": ({"sensors": [None]}, "sensors: an index must be an integer, got None"),
    "a sensor as truth": ({"sensors": [True]}, "sensors: an index must be an integer, got True"),
    "a sensor without name": ({"sensors": ""}, "the scene has no sensor ''; known: sensor"),
    "a sensor of another name": ({"sensors": ["sensr"]}, "the scene has no sensor 'sensr'; did you mean 'sensor'"),
    "a sensor beyond the last": ({"sensors": np.int64(1)}, "sensors must be indices from 0 to 0, got 1"),
    "samples without end": ({"spp": INF}, "spp must be an integer of at least 1, got inf"),
    "samples that are no number": ({"spp": NAN}, "spp must be an integer of at least 1, got nan"),
    "samples as a list": ({"spp": [4]}, "spp must be an integer of at least 1, got [4]"),
    "samples as a vector": ({"spp": torch.tensor([2, 2])}, "spp must be an integer of at least 1, got tensor([2, 2])"),
}


@pytest.mark.parametrize("arguments, message", CALLS.values(), ids=CALLS)
def test_a_call(arguments, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        renderer()(**arguments)


SETTINGS_THAT_MAKE_NO_SENSE = {
    "no depth": ({"max_depth": NAN}, ValueError, "max_depth must be an integer, got nan"),
    "depth as text": ({"max_depth": "8"}, ValueError, "max_depth must be an integer, got '8'"),
    "depth as truth": ({"max_depth": True}, ValueError, "max_depth must be an integer, got True"),
    "depth below -1": ({"max_depth": -5}, ValueError, "max_depth must be -1 (unlimited) or at least 0, got -5"),
    "roulette at once": ({"rr_depth": 0}, ValueError, "rr_depth must be at least 1, got 0"),
    "next-event estimation as text": ({"nee": "x"}, ValueError, "nee must be True or False, got 'x'"),
    "next-event estimation as number": ({"nee": 1}, ValueError, "nee must be True or False, got 1"),
    "emitters hidden by text": ({"hide_emitters": "no"}, ValueError, "hide_emitters must be True or False, got 'no'"),
    "negative chunk": ({"chunk": -3}, ValueError, "chunk must be an integer of at least 1, got -3"),
    "chunk without end": ({"chunk": INF}, ValueError, "chunk must be an integer of at least 1, got inf"),
    "unknown sampling": ({"sampling": "foo"}, ValueError, "sampling='foo' is not known; known: attached"),
    "several samplings": ({"sampling": ["hybrid"]}, ValueError, "sampling=['hybrid'] is not known; did you mean 'hybrid'"),
    "strategy as number": ({"adjoint": 4}, TypeError, "adjoint must be one of MemoizedAdjoint, QuadraticAdjoint"),
    "budget that is no number": ({"memory_budget": NAN}, ValueError, "memory_budget must be a number of bytes"),
    "negative budget": ({"memory_budget": "-1GiB"}, ValueError, "memory_budget must be a number of bytes"),
    "budget beyond float": ({"memory_budget": "1e400GiB"}, ValueError, "memory_budget must be a number of bytes"),
    "budget as truth": ({"memory_budget": True}, ValueError, "memory_budget must be a number of bytes"),
    "budget as bytes": ({"memory_budget": b"1GiB"}, ValueError, "memory_budget must be a number of bytes"),
}


@pytest.mark.parametrize("setting, kind, message", SETTINGS_THAT_MAKE_NO_SENSE.values(), ids=SETTINGS_THAT_MAKE_NO_SENSE)
def test_a_setting(setting, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        renderer(**setting)


@pytest.mark.parametrize("setting, kind, message", SETTINGS_THAT_MAKE_NO_SENSE.values(), ids=SETTINGS_THAT_MAKE_NO_SENSE)
def test_a_setting_that_is_assigned_later(setting, kind, message):
    ours = renderer()
    (name, value), = setting.items()
    setattr(ours, name, value)
    with pytest.raises(kind, match=re.escape(message)):
        ours()


def test_settings_assigned_later_count():
    ours = renderer()
    ours.spp, ours.max_depth, ours.nee = 4, 2, False
    assert torch.equal(ours(seed=1), rb.render(scene(), spp=4, max_depth=2, nee=False, seed=1))
    ours.spp = None
    assert ours.spp == scene().sensors[0].sampler.sample_count
    ours.spp = -1
    with pytest.raises(ValueError, match="spp must be an integer of at least 1, got -1"):
        ours()


def test_a_budget_of_a_byte():
    message = r"memory_budget of 1 B is too small: the most frugal plan .* needs [1-9][0-9.]* .?i?B"
    with pytest.raises(ValueError, match=message):
        renderer(memory_budget=1)()


@pytest.mark.parametrize("keep_hits", ["no", 1, None], ids=repr)
@pytest.mark.parametrize("strategy", [rb.MemoizedAdjoint, rb.ReplayAdjoint, rb.QuadraticAdjoint])
def test_hits_that_are_kept_by_something_else_than_truth(strategy, keep_hits):
    with pytest.raises(ValueError, match=re.escape(f"keep_hits must be True or False, got {keep_hits!r}")):
        strategy(keep_hits=keep_hits)


@pytest.mark.parametrize("stride", [NAN, INF, -3, "Log", b"log", [1], torch.tensor(1.5)], ids=repr)
def test_a_stride(stride):
    message = f"stride must be an integer of at least 1, 'sqrt' or 'log', got {stride!r}"
    with pytest.raises(ValueError, match=re.escape(message)):
        rb.MemoizedAdjoint(stride)


def test_a_stride_may_be_an_integer_of_numpy():
    assert rb.MemoizedAdjoint(np.int64(3)) == rb.MemoizedAdjoint(3)


PARAMETERS = {
    "misspelt": (lambda: replaced(GREY, "floor.bsdf.reflectance.valeu"), AttributeError,
                 "there is no parameter 'scene.floor.bsdf.reflectance.valeu'; did you mean "
                 "'scene.floor.bsdf.reflectance.value'"),
    "of the scene": (lambda: replaced(GREY, "floor"), TypeError, "is not an instance of torch.Tensor"),
    "at the scene": (lambda: replaced(GREY, "nothing"), AttributeError, "there is no parameter 'scene.nothing'"),
    "at the renderer": (lambda: functional_call(renderer(), {"nothing": GREY}, kwargs={"seed": 0}), AttributeError,
                        "there is no parameter 'nothing'"),
    "at a plugin": (lambda: replaced(GREY, "sky.colour"), AttributeError, "there is no parameter 'scene.sky.colour'"),
    "of whole numbers": (lambda: replaced(torch.ones(3, dtype=torch.int32)), TypeError,
                         f"parameter '{NAME}' is torch.int32; a scene is rendered in torch.float32 or torch.float64"),
    "of truth values": (lambda: replaced(torch.ones(3, dtype=torch.bool)), TypeError, f"parameter '{NAME}' is torch.bool"),
    "of complex numbers": (lambda: replaced(torch.ones(3, dtype=torch.complex64)), TypeError,
                           f"parameter '{NAME}' is torch.complex64"),
    "in half precision": (lambda: replaced(GREY.half()), TypeError, f"parameter '{NAME}' is torch.float16"),
    "in double precision": (lambda: replaced(GREY.double()), TypeError, f"parameter '{NAME}' is torch.float64 on cpu, but "),
    "on another device": (lambda: replaced(GREY.to("meta")), TypeError,
                          f"parameter '{NAME}' is torch.float32 on meta, but "),
    "sparse": (lambda: replaced(GREY.to_sparse()), TypeError, f"parameter '{NAME}' {DENSE}"),
    "of five numbers": (lambda: replaced(torch.rand(5)), ValueError,
                        f"parameter '{NAME}' must have shape () or (3,), got (5,)"),
    "of no numbers": (lambda: replaced(torch.rand(0)), ValueError,
                      f"parameter '{NAME}' must have shape () or (3,), got (0,)"),
    "not finite": (lambda: replaced(torch.tensor([0.5, NAN, 0.5])), ValueError,
                   f"parameter '{NAME}' has 1 of 3 values that are NaN or infinite"),
    "infinite": (lambda: replaced(torch.tensor([0.5, -INF, 0.5])), ValueError,
                 f"parameter '{NAME}' has 1 of 3 values that are NaN or infinite"),
    "negative": (lambda: replaced(-GREY), ValueError, f"parameter '{NAME}' must be at least 0"),
    "a pose of zeros": (lambda: replaced(torch.zeros(4, 4), "floor.to_world"), ValueError, "parameter 'floor.to_world'"),
    "a pose in perspective": (lambda: replaced(torch.ones(4, 4), "floor.to_world"), ValueError,
                              "to_world must be affine: its last row must be 0 0 0 1"),
    "a pose of three rows": (lambda: replaced(torch.eye(4)[:3], "sensor.to_world"), ValueError,
                             "parameter 'sensor.to_world' must have shape (4, 4), got (3, 4)"),
    "a field of view of 180 degrees": (lambda: replaced(torch.tensor(180.0), "sensor.x_fov"), ValueError,
                                       "parameter 'sensor.x_fov'"),
    "light below zero": (lambda: replaced(-GREY, "sky.radiance.value"), ValueError, "parameter 'sky.radiance.value'"),
}


@pytest.mark.parametrize("call, kind, message", PARAMETERS.values(), ids=PARAMETERS)
def test_a_parameter_of_a_functional_call(call, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        call()


def test_a_parameter_without_the_prefix_of_the_scene():
    """torch's own message has no room for the advice; it is the cause."""
    with pytest.raises(AttributeError) as caught:
        functional_call(renderer(), {NAME: GREY}, kwargs={"seed": 0})
    assert ("a renderer has no attribute 'floor', but its scene has, renderer.scene.floor: names of its parameters begin "
            "with 'scene.floor.' in functional_call") in str(caught.value.__cause__)
    assert not hasattr(renderer(), "floor") and not hasattr(renderer(), "nothing")


# Name -> (a call with an argument that there is not, what the message says).
ARGUMENTS = {
    "sensor": (lambda ours: ours(sensor=0), "Renderer.forward() has no argument 'sensor'; did you mean 'sensors'"),
    "seeds": (lambda ours: ours(seeds=0), "has no argument 'seeds'; did you mean 'seed'"),
    "seed_grads": (lambda ours: ours(seed_grads=0), "has no argument 'seed_grads'; did you mean 'seed_grad'"),
    "of aovs": (lambda ours: ours.aovs(["depth"], sensor=0), "Renderer.aovs() has no argument 'sensor'; did you mean 'sens"),
    "of memory_plan": (lambda ours: ours.memory_plan(sensor=0), "memory_plan() has no argument 'sensor'"),
    "of render": (lambda ours: rb.render(ours.scene, sensor=0), "render() has no argument 'sensor'; did you mean 'sensors'"),
    "a setting of render": (lambda ours: rb.render(ours.scene, max_dept=3), "'max_dept'; did you mean 'max_depth'"),
    "of jvp": (lambda ours: rb.jvp(ours.scene, {NAME: GREY}, sensor=0), "jvp() has no argument 'sensor'; did you mean"),
    "of check_gradient": (lambda ours: rb.check_gradient(ours.scene, NAME, sensor=0),
                          "check_gradient() has no argument 'sensor'; did you mean 'sensors'"),
}


@pytest.mark.parametrize("call, message", ARGUMENTS.values(), ids=ARGUMENTS)
def test_an_argument_that_there_is_not(call, message):
    with pytest.raises(TypeError, match=re.escape(message)):
        call(renderer())


def without_value(ours: rb.Renderer) -> None:
    del ours.scene.floor.bsdf.reflectance.value


def value_of_none(ours: rb.Renderer) -> None:
    ours.scene.floor.bsdf.reflectance.value = None


MUTILATIONS = {
    "a parameter is deleted": (without_value, AttributeError, f"parameter '{NAME}' is missing"),
    "a parameter is none": (value_of_none, AttributeError, f"parameter '{NAME}' is missing"),
    "the scene is on no device": (lambda ours: ours.to("meta"), TypeError, "is on the device meta, which holds no numbers"),
    "the renderer is in half precision": (lambda ours: ours.half(), TypeError, "is torch.float16; a scene is rendered in"),
    "one shape is in double precision": (lambda ours: ours.scene.floor.double(), TypeError, "a scene has one dtype"),
    "memory that was never written": (lambda ours: [p.data.fill_(NAN) for p in ours.parameters()], ValueError,
                                      "values that are NaN or infinite"),
}


@pytest.mark.parametrize("mutilate, kind, message", MUTILATIONS.values(), ids=MUTILATIONS)
def test_a_scene_that_is_mutilated_after_loading(mutilate, kind, message):
    ours = renderer()
    ours()
    mutilate(ours)
    with pytest.raises(kind, match=re.escape(message)):
        ours()


STATES = {
    "of another scene": (lambda: scene().load_state_dict(cornell().state_dict()), 'Missing key(s) in state_dict: "floor'),
    "with a bitmap of another size": (lambda: textured().load_state_dict(
        textured().state_dict() | {"floor.bsdf.reflectance.data": torch.rand(9, 9, 3)}), "size mismatch for floor.bsdf"),
}


@pytest.mark.parametrize("call, message", STATES.values(), ids=STATES)
def test_a_state(call, message):
    with pytest.raises(RuntimeError, match=re.escape(message)):
        call()


TRANSFORMS = {
    "vmap": lambda f: torch.func.vmap(f)(torch.rand(2, 3)),
    "grad": lambda f: torch.func.grad(lambda x: f(x).sum())(GREY),
    "vjp": lambda f: torch.func.vjp(f, GREY),
    "jacrev": lambda f: torch.func.jacrev(f)(GREY),
    "jacfwd": lambda f: torch.func.jacfwd(f)(GREY),
    "hessian": lambda f: torch.func.hessian(lambda x: f(x).sum())(GREY),
    "jvp of grad": lambda f: torch.func.jvp(torch.func.grad(lambda x: f(x).sum()), (GREY,), (GREY,)),
}


@pytest.mark.parametrize("transform", TRANSFORMS.values(), ids=TRANSFORMS)
def test_a_transform_of_torch_func(transform):
    ours = renderer()
    with pytest.raises(RuntimeError, match="of the transforms of torch.func rendering works in jvp only, and not nested"):
        transform(lambda x: functional_call(ours, {f"scene.{NAME}": x}, kwargs={"seed": 0}))


TANGENTS = {
    "unknown": ({"nope": GREY}, AttributeError, "the scene has no parameter 'nope'"),
    "of nothing": ({}, ValueError, "tangents must name at least one parameter, got none"),
    "of another shape": ({NAME: GREY[:2]}, ValueError, f"the tangent of '{NAME}' must have shape (3,), got (2,)"),
    "not finite": ({NAME: NAN * GREY}, ValueError, f"the tangent of '{NAME}' must be finite"),
    "sparse": ({NAME: GREY.to_sparse()}, TypeError, f"the tangent of '{NAME}' {DENSE}"),
    "truth values": ({NAME: GREY > 0}, TypeError, f"the tangent of '{NAME}' must be numbers, got torch.bool: convert it"),
    "complex": ({NAME: GREY.cfloat()}, ValueError, f"the tangent of '{NAME}' must be real numbers, got torch.complex64"),
    "on no device": ({NAME: GREY.to("meta")}, ValueError, f"the tangent of '{NAME}' is on the device meta, which holds no"),
    "text": ({NAME: "up"}, TypeError, f"the tangent of '{NAME}' must be a tensor or an array of numbers, got str"),
    "none": ({NAME: None}, TypeError, f"the tangent of '{NAME}' must be a tensor or an array of numbers, got NoneType"),
    "ragged": ({NAME: [[1, 2], [3]]}, TypeError, f"the tangent of '{NAME}' must be a tensor or an array of numbers, got li"),
    "attached": ({NAME: (GREY.clone().requires_grad_() * 2)[:2]}, ValueError, "must have shape (3,), got (2,)"),
    "with the prefix of the scene": ({f"scene.{NAME}": GREY}, AttributeError, f"the scene has no parameter 'scene.{NAME}'"),
    "a set": ({NAME}, TypeError, "tangents must map names of parameters to tensors, got set"),
    "a tensor": (GREY, TypeError, "tangents must map names of parameters to tensors, got Tensor"),
}


@pytest.mark.parametrize("tangents, kind, message", TANGENTS.values(), ids=TANGENTS)
def test_tangents(tangents, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        rb.jvp(scene(), tangents, spp=1)


CHECKS = {
    "no step": ({"step": NAN}, ValueError, "step must be greater than 0 and finite, got nan"),
    "step backwards": ({"step": -0.1}, ValueError, "step must be greater than 0 and finite, got -0.1"),
    "step as text": ({"step": "a"}, ValueError, "step must be a number, got 'a'"),
    "step as a vector": ({"step": [0.1, 0.2]}, ValueError, "step must be a number, got [0.1, 0.2]"),
    "step as truth": ({"step": True}, ValueError, "step must be a number, got True"),
    "step without end": ({"step": INF}, ValueError, "step must be greater than 0 and finite, got inf"),
    "step beyond the domain": ({"step": 1e8}, ValueError, f"differences of '{NAME}' by steps of 1e+08 along this direction "
                               "leave its domain to both sides; give a smaller step"),
    "seed as text": ({"seed": "a"}, ValueError, "seed must be an integer, got 'a'"),
    "fractional seed": ({"seed": 0.5}, ValueError, "seed must be an integer, got 0.5"),
    "samples as text": ({"spp": "many"}, ValueError, "spp must be an integer of at least 1, got 'many'"),
    "batches as a fraction": ({"batches": 8.5}, ValueError, "batches must be an integer of at least 1, got 8.5"),
    "direction on no device": ({"direction": GREY.to("meta")}, ValueError, f"direction of '{NAME}' is on the device meta"),
    "direction that is sparse": ({"direction": GREY.to_sparse()}, TypeError, f"direction of '{NAME}' {DENSE}"),
    "direction of truth values": ({"direction": GREY > 0}, TypeError, f"direction of '{NAME}' must be numbers, got torch"),
    "direction of no numbers": ({"direction": {}}, TypeError, f"direction of '{NAME}' must be a tensor or an array of numb"),
    "ragged direction": ({"direction": [[1], [2, 3]]}, TypeError, f"direction of '{NAME}' must be a tensor or an array of"),
    "no direction": ({"direction": torch.zeros(3)}, ValueError, f"direction of '{NAME}' must not be zero everywhere"),
    "unknown direction": ({"direction": "up"}, ValueError, "direction must be 'random' or 'ones' or an array of shape (3,)"),
    "too few batches": ({"batches": 3}, ValueError, "batches must be at least 8"),
    "no such sensor": ({"sensors": [3]}, ValueError, "sensors must be indices from 0 to 0, got [3]"),
}


@pytest.mark.parametrize("arguments, kind, message", CHECKS.values(), ids=CHECKS)
def test_a_check_of_a_gradient(arguments, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        rb.check_gradient(scene(), NAME, **arguments)


@pytest.mark.parametrize("name", [3, None, [NAME], b"floor"], ids=repr)
def test_the_name_of_a_parameter(name):
    with pytest.raises(TypeError, match=re.escape(f"the name of a parameter must be a string, got {name!r}")):
        scene().get_parameter(name)


def test_a_loss_that_is_not_finite_is_not_blamed_on_the_rendering():
    ours = scene()
    value = ours.get_parameter(NAME).requires_grad_()
    image = rb.render(ours, **SETTINGS)
    with pytest.raises(FloatingPointError, match="it is the loss that is not finite, not the rendering"):
        torch.autograd.grad(image, value, torch.full_like(image, NAN))


def test_radiance_beyond_float32_is_named():
    ours = renderer()
    ours.scene.get_parameter("sky.radiance.value").data.fill_(3e38)
    with pytest.raises(ValueError, match=r"parameter 'sky.radiance.value' must be at most 1e\+18 in magnitude, got 3e\+38"):
        ours()


def test_a_second_backward_pass_is_refused_by_torch():
    ours = scene()
    ours.get_parameter(NAME).requires_grad_()
    loss = rb.render(ours, **SETTINGS).sum()
    loss.backward()
    with pytest.raises(RuntimeError, match="Trying to backward through the graph a second time"):
        loss.backward()


def gradient(ours: rb.Renderer) -> torch.Tensor:
    value = ours.scene.get_parameter(NAME).requires_grad_()
    found, = torch.autograd.grad(ours(seed=1).square().sum(), value)
    assert found.abs().min() > 0
    return found


def in_inference_mode(ours: rb.Renderer) -> torch.Tensor:
    with torch.inference_mode():
        assert not ours(seed=1).requires_grad
    return gradient(ours)


def deterministic(ours: rb.Renderer) -> torch.Tensor:
    torch.use_deterministic_algorithms(True)
    try:
        return gradient(ours)
    finally:
        torch.use_deterministic_algorithms(False)


def watched(ours: rb.Renderer) -> torch.Tensor:
    with torch.autograd.detect_anomaly(check_nan=True):
        return gradient(ours)


def checkpointed(ours: rb.Renderer) -> torch.Tensor:
    value = ours.scene.get_parameter(NAME).requires_grad_()
    image = torch.utils.checkpoint.checkpoint(ours, 1, use_reentrant=False)
    return torch.autograd.grad(image.square().sum(), value)[0]


def offloaded(ours: rb.Renderer) -> torch.Tensor:
    with torch.autograd.graph.save_on_cpu():
        return gradient(ours)


def through_a_file(ours: rb.Renderer) -> torch.Tensor:
    file = io.BytesIO()
    torch.save(ours, file)
    file.seek(0)
    return gradient(torch.load(file, weights_only=False))


def changed_before_the_backward_pass(ours: rb.Renderer) -> torch.Tensor:
    value = ours.scene.get_parameter(NAME).requires_grad_()
    loss = ours(seed=1).square().sum()
    value.data.fill_(0.1)
    return torch.autograd.grad(loss, value)[0]


MODES = {
    "after inference mode": in_inference_mode, "deterministic algorithms": deterministic, "anomaly mode": watched,
    "checkpoint": checkpointed, "saved tensors elsewhere": offloaded, "a file": through_a_file,
    "a value changed before the backward pass": changed_before_the_backward_pass,
    "a deep copy": lambda ours: gradient(copy.deepcopy(ours)),
    "a deep copy after a rendering": lambda ours: (ours(), gradient(copy.deepcopy(ours)))[1],
    "a pickle": lambda ours: gradient(pickle.loads(pickle.dumps(ours))),
    "evaluation": lambda ours: gradient(ours.eval()),
    "shared memory": lambda ours: gradient(ours.share_memory()),
}


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore:Anomaly Detection")
@pytest.mark.parametrize("mode", MODES.values(), ids=MODES)
def test_gradients_are_the_same_under(mode):
    assert torch.equal(mode(renderer()), gradient(renderer()))


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
def test_the_gradient_by_one_parameter_is_the_same_beside_those_of_all_others():
    """To rounding: what is found for more derivatives adds up in another order."""
    for compiled in (True, False):
        found, expected = (renderer(compile=compiled).double() for _ in range(2))
        torch.testing.assert_close(gradient(found.requires_grad_()), gradient(expected), rtol=1e-14, atol=0)


def bitmap_renderer() -> rb.Renderer:
    """A floor with an image of 4 x 4 texels and a network beside it."""
    network = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Sigmoid())
    bsdfs = ({"type": "diffuse", "reflectance": {"type": "bitmap", "data": torch.full((4, 4, 3), 0.5)}},
             {"type": "diffuse", "reflectance": network}, {"type": "diffuse", "reflectance": 0.5})
    shapes = {f"shape_{k}": {"type": "rectangle", "bsdf": bsdf} for k, bsdf in enumerate(bsdfs)}
    film = {"type": "hdrfilm", "width": 2, "height": 2}
    ours = rb.load_dict({"type": "scene", "sensor": {"type": "perspective", "film": film}, "sky": {"type": "constant"},
                         **shapes})
    return rb.Renderer(ours, spp=1, max_depth=2, compile=False)


RESIZED = {
    "a bitmap": ("shape_0.bsdf.reflectance.data", (8, 8, 3), "from (4, 4, 3) to (8, 8, 3)"),
    "a bitmap to fewer": ("shape_0.bsdf.reflectance.data", (1, 1, 3), "from (4, 4, 3) to (1, 1, 3)"),
    "a layer": ("shape_1.bsdf.reflectance.module.0.weight", (5, 2), "from (3, 2) to (5, 2)"),
    "a colour": ("shape_2.bsdf.reflectance.value", (3,), "from () to (3,)"),
}


@pytest.mark.parametrize("name, shape, message", RESIZED.values(), ids=RESIZED)
def test_a_parameter_resized_before_the_backward_pass(name, shape, message):
    ours = bitmap_renderer()
    parameter = ours.scene.get_parameter(name).requires_grad_()
    image = ours(seed=1)
    parameter.data = torch.rand(shape)
    message = f"the parameter {name!r} has been resized between a rendering and its backward pass, {message}"
    with pytest.raises(RuntimeError, match=re.escape(message)):
        image.sum().backward()


def batch_of_gradients(ours: rb.Renderer) -> None:
    colour = ours.scene.get_parameter(NAME).requires_grad_()
    image = ours(seed=1)
    torch.autograd.grad(image, colour, torch.ones(2, *image.shape), is_grads_batched=True)


def vectorized_jacobian(ours: rb.Renderer) -> None:
    torch.autograd.functional.jacobian(lambda value: functional_call(ours, {f"scene.{NAME}": value}, kwargs={"seed": 0}),
                                       torch.full((3,), 0.5), vectorize=True)


BATCH = "the backward pass of a rendering takes one gradient of the image at a time, and a batch is given (is_grads"
FOREIGN = {
    "a batch of gradients": (batch_of_gradients, RuntimeError, BATCH),
    "a vectorized jacobian": (vectorized_jacobian, RuntimeError, BATCH),
    "a trace": (lambda ours: torch.jit.trace(ours, ()), RuntimeError, "a rendering cannot be traced by torch.jit.trace"),
}


@pytest.mark.parametrize("call, kind, message", FOREIGN.values(), ids=FOREIGN)
def test_what_torch_can_do_with_other_functions(call, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        call(renderer())


QUANTITIES = {
    "no name": ({"names": []}, ValueError, "aovs must name at least one quantity, got none; known: albedo"),
    "a word": ({"names": "depth"}, TypeError, "aovs must be a sequence of names such as [\"depth\", \"sh_normal\"], got 'd"),
    "a number": ({"names": [3]}, TypeError, "aovs must be a sequence of names"),
    "a misspelt name": ({"names": ["dept"]}, ValueError, "aovs: the quantity 'dept' is not known, nor is its mean square, "),
    "the square of a square": ({"names": ["m2_m2_depth"]}, ValueError, "aovs: the quantity 'm2_m2_depth' is not known"),
    "an empty name": ({"names": [""]}, ValueError, "aovs: the quantity '' is not known"),
    "no list": ({}, ValueError, "the scene's integrator lists no outputs; name some"),
    "seed as text": ({"names": ["depth"], "seed": "a"}, ValueError, "seed must be an integer, got 'a'"),
    "seed of the derivative as text": ({"names": ["depth"], "seed_grad": "a"}, ValueError, "seed_grad must be an integer"),
    "fractional seed of the derivative": ({"names": ["depth"], "seed_grad": 0.5}, ValueError, "seed_grad must be an intege"),
    "no sensor": ({"names": ["depth"], "sensors": []}, ValueError, "sensors must be indices from 0 to 0, got []"),
    "no samples": ({"names": ["depth"], "spp": 0}, ValueError, "spp must be an integer of at least 1, got 0"),
}


@pytest.mark.parametrize("arguments, kind, message", QUANTITIES.values(), ids=QUANTITIES)
def test_quantities(arguments, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        renderer().aovs(**arguments)


PICTURES = {
    "on no device": ((IMAGE.to("meta"),), TypeError, "channel 'R' must be a dense tensor of numbers, got one on the device"),
    "sparse": ((IMAGE.to_sparse(),), TypeError, "channel 'R' must be a dense tensor of numbers, got one of torch.sparse_co"),
    "complex": ((IMAGE.cfloat(),), TypeError, "an image must be a tensor of floating point numbers, got torch.complex64"),
    "an array": ((IMAGE.numpy(),), TypeError, "an image must be a tensor of floating point numbers, got ndarray"),
    "not finite": ((IMAGE * NAN,), ValueError, "not written, 4 of 4 pixels are NaN or infinite in float32"),
    "beyond float32": ((IMAGE.double() + 1e39,), ValueError, "not written, 4 of 4 pixels are NaN or infinite in float32"),
    "of two channels": ((IMAGE[:2],), ValueError, "an image must have shape (3, H, W), got (2, 2, 2)"),
    "a number as channel": ((IMAGE, {"Z": 3}), TypeError, "channel 'Z' must be a dense tensor of numbers, got int"),
    "none as channel": ((IMAGE, {"Z": None}), TypeError, "channel 'Z' must be a dense tensor of numbers, got NoneType"),
    "a channel on no device": ((IMAGE, {"Z": IMAGE[0].to("meta")}), TypeError, "channel 'Z' must be a dense tensor of numb"),
    "a channel of another size": ((IMAGE, {"Z": IMAGE[0, :1]}), ValueError, "channel 'Z' must have shape (2, 2), got (1, 2"),
}


@pytest.mark.parametrize("arguments, kind, message", PICTURES.values(), ids=PICTURES)
def test_an_image_to_be_written(arguments, kind, message, tmp_path):
    with pytest.raises(kind, match=re.escape(f"{tmp_path / 'a.exr'}: {message}")):
        rb.save_image(tmp_path / "a.exr", *arguments)
    assert not list(tmp_path.iterdir())


def module_of(parameter: str, value) -> torch.nn.Module:
    network = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Sigmoid())
    setattr(network[0], parameter, None if value is None else torch.nn.Parameter(value))
    return network


def with_buffer() -> torch.nn.Module:
    network = torch.nn.Linear(2, 3)
    network.register_buffer("extra", torch.zeros(3, device="meta"))
    return network


MODULES = {
    "without shape": (lambda: torch.nn.Sequential(torch.nn.LazyLinear(3)),
                      "module: its 0.weight has no shape before the module has run: call it once, on torch.zeros(1, 2)"),
    "on no device": (lambda: torch.nn.Linear(2, 3).to("meta"),
                     "module: its weight is on the device meta, which holds no numbers: make the module on the CPU"),
    "a bias on no device": (lambda: module_of("bias", torch.zeros(3, device="meta")), "module: its 0.bias is on the device"),
    "a buffer on no device": (with_buffer, "module: its extra is on the device meta, which holds no numbers"),
}


@pytest.mark.parametrize("make, message", MODULES.values(), ids=MODULES)
@pytest.mark.parametrize("way", ["dict", "assignment", "texture"])
def test_modules_that_hold_no_numbers(make, message, way):
    ours = scene() if way == "assignment" else None
    with pytest.raises(ValueError, match=re.escape(message)):
        if way == "dict":
            load(floor=rectangle((0, 0, 0), bsdf={"type": "diffuse", "reflectance": make()}))
        elif way == "assignment":
            ours.floor.bsdf.reflectance = make()
        else:
            rb.NeuralTexture(make())


WIDTHS = {
    "too many coordinates": (torch.nn.Linear(3, 3), RuntimeError, "the module of the texture 'floor.bsdf.reflectance' has "),
    "two channels": (torch.nn.Linear(2, 2), ValueError, "the module of the texture 'floor.bsdf.reflectance' must return sh"),
    "images": (torch.nn.Conv2d(2, 3, 1), RuntimeError, "the module of the texture 'floor.bsdf.reflectance' has failed on p"),
    "flat": (torch.nn.Flatten(0), ValueError, "the module of the texture 'floor.bsdf.reflectance' must return shape"),
}


@pytest.mark.parametrize("module, kind, message", WIDTHS.values(), ids=WIDTHS)
def test_modules_of_wrong_width(module, kind, message):
    ours = scene()
    ours.floor.bsdf.reflectance = module
    with pytest.raises(kind, match=re.escape(message)):
        rb.render(ours, compile=False, **SETTINGS)


def test_half_precision_in_a_description_becomes_the_scenes():
    for half in (GREY.bfloat16(), GREY.half(), GREY.to(torch.float8_e4m3fn)):
        floor = rectangle((0, 0, 0), bsdf={"type": "diffuse", "reflectance": {"type": "rgb", "value": half}})
        ours = load(torch.float32, sensor=sensor(2), floor=floor, sky={"type": "constant"})
        assert torch.equal(ours.floor.bsdf.reflectance.value, GREY)


TRUTH = "got Tensor of shape (2, 2, 3) of torch.bool"
NOTHING = "on the device meta, which holds no numbers"
GIVEN = {
    "truth values as a bitmap": ({"type": "bitmap", "data": torch.ones(2, 2, 3, dtype=torch.bool)}, TRUTH),
    "truth values as a colour": ({"type": "rgb", "value": torch.ones(3, dtype=torch.bool)}, "of shape (3,) of torch.bool"),
    "truth values as a reflectance": (torch.ones(3, dtype=torch.bool), "of shape (3,) of torch.bool"),
    "a bitmap on no device": ({"type": "bitmap", "data": torch.ones(2, 2, 3, device="meta")}, NOTHING),
    "a colour on no device": ({"type": "rgb", "value": torch.ones(3, device="meta")}, NOTHING),
    "sparse numbers as a colour": ({"type": "rgb", "value": GREY.to_sparse()}, "torch.sparse_coo, which .to_dense() makes"),
    "complex numbers as a colour": ({"type": "rgb", "value": GREY.cfloat()}, "of shape (3,) of torch.complex64"),
    "a parameter on no device": ({"type": "rgb", "value": torch.nn.Parameter(torch.ones(3, device="meta"))}, NOTHING),
}


@pytest.mark.parametrize("value, message", GIVEN.values(), ids=GIVEN)
def test_values_of_a_description_that_are_no_numbers(value, message):
    floor = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": value}}
    with pytest.raises(rb.SceneError, match=re.escape(message)):
        rb.load_dict({"type": "scene", "sensor": {"type": "perspective"}, "sky": {"type": "constant"}, "floor": floor})
