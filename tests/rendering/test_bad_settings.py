"""Renderer and render: each mistake gets one message that says what was expected and what came."""

import re

import pytest

import torch_radbp as rb
from tests.scenes import cornell, load, rectangle, sensor, textured

pytestmark = pytest.mark.hostile

CONSTRUCTOR = {
    "spp of zero": ({"spp": 0}, ValueError, "spp must be an integer of at least 1, got 0"),
    "negative spp": ({"spp": -4}, ValueError, "spp must be an integer of at least 1, got -4"),
    "half a sample": ({"spp": 1.5}, ValueError, "spp must be an integer of at least 1, got 1.5"),
    "spp as text": ({"spp": "16"}, ValueError, "spp must be an integer of at least 1, got '16'"),
    "spp as truth": ({"spp": True}, ValueError, "spp must be an integer of at least 1, got True"),
    "chunk of zero": ({"chunk": 0}, ValueError, "chunk must be an integer of at least 1, got 0"),
    "chunk as number": ({"chunk": 1e6}, ValueError, "chunk must be an integer of at least 1, got 1000000.0"),
    "depth below -1": ({"max_depth": -2}, ValueError, "max_depth must be -1 (unlimited) or at least 0, got -2"),
    "roulette at zero": ({"rr_depth": 0}, ValueError, "rr_depth must be at least 1, got 0"),
    "adjoint by name": ({"adjoint": "log"}, TypeError, "adjoint must be one of MemoizedAdjoint, QuadraticAdjoint, "
                                                       "ReplayAdjoint, TapeAdjoint, or of a class derived from "
                                                       "AdjointStrategy, got 'log'"),
    "adjoint as class": ({"adjoint": rb.MemoizedAdjoint}, TypeError, "adjoint must be one of MemoizedAdjoint"),
    "terms to be read once": ({"terms": iter(["interior"])}, ValueError, "it must be a set or list of some of interior"),
    "no terms": ({"terms": None}, ValueError, "terms=None is not known; it must be a set or list of some of interior"),
    "unknown sampling": ({"sampling": "both"}, ValueError, "sampling='both' is not known; known: attached"),
    "memory budget": ({"memory_budget": "plenty"}, ValueError, "memory_budget"),
    "memory budget of zero": ({"memory_budget": 0}, ValueError, "memory_budget"),
}


@pytest.mark.parametrize("settings, kind, message", CONSTRUCTOR.values(), ids=CONSTRUCTOR)
def test_a_setting_that_makes_no_sense(settings, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        rb.Renderer(cornell(), **settings)
    with pytest.raises(kind, match=re.escape(message)):
        rb.render(cornell(), **settings)


CALLS = {
    "spp of zero": ({"spp": 0}, "spp must be an integer of at least 1, got 0"),
    "sensor that is not there": ({"sensors": [1]}, "sensors must be indices from 0 to 0, got [1]"),
    "sensor from the end": ({"sensors": [-1]}, "sensors must be indices from 0 to 0, got [-1]"),
    "no sensor": ({"sensors": []}, "sensors must be indices from 0 to 0, got []"),
}


@pytest.mark.parametrize("call, message", CALLS.values(), ids=CALLS)
def test_a_call_that_makes_no_sense(call, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        rb.Renderer(cornell(), spp=1)(**call)


def test_something_else_than_a_scene():
    with pytest.raises(TypeError, match=re.escape("scene must be a torch_radbp.Scene (from load or load_dict), got dict")):
        rb.Renderer({"type": "scene"})


@pytest.mark.parametrize("stride", [0, -1, 1.5, True, "cbrt", None], ids=repr)
def test_a_stride_that_is_none(stride):
    message = f"stride must be an integer of at least 1, 'sqrt' or 'log', got {stride!r}"
    with pytest.raises(ValueError, match=re.escape(message)):
        rb.MemoizedAdjoint(stride)


def test_an_unknown_caster():
    with pytest.raises(ValueError, match=re.escape("unknown ray caster 'optix'; known are 'embree', 'direct', 'brute'")):
        rb.Renderer(cornell(), spp=1, caster="optix")()


def test_sensors_of_different_size_in_one_call():
    scene = cornell(sensors={"small": sensor(4), "large": sensor(6)})
    message = ("the sensors of one call must have films of one size, got [(4, 4), (6, 6)]; render them in separate calls")
    renderer = rb.Renderer(scene, spp=1, max_depth=2)
    with pytest.raises(ValueError, match=re.escape(message)):
        renderer()
    assert renderer(sensors=[0]).shape == (1, 3, 4, 4) and renderer(sensors=[1, 1]).shape == (2, 3, 6, 6)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_parameter_that_is_not_finite_is_named(value):
    scene = cornell()
    scene.get_parameter("red.reflectance.value").data[1] = value
    message = "parameter 'red.reflectance.value' has 1 of 3 values that are NaN or infinite"
    with pytest.raises(ValueError, match=re.escape(message)):
        rb.render(scene, spp=1)


def test_an_unknown_parameter_is_answered_with_the_nearest_names():
    with pytest.raises(AttributeError, match="no parameter 'gren.reflectance.value'; did you mean 'green"):
        cornell().get_parameter("gren.reflectance.value")
    with pytest.raises(AttributeError, match="no parameter 'floor'; .*known: .*floor.bsdf.reflectance.data"):
        textured().get_parameter("floor")


def test_a_scene_without_shapes():
    scene = load(sensor=sensor(2), sky={"type": "constant"})
    with pytest.raises(ValueError, match="the scene has no shape to render: add a rectangle, cube"):
        rb.Renderer(scene)


def test_a_scene_without_light_sensor_or_with_two_skies():
    light, view, shape = {"type": "constant"}, sensor(2), rectangle((0, 0, 0))
    with pytest.raises(rb.SceneError, match="no sensor: add <sensor type=\"perspective\">"):
        load(sky=light, shape=shape)
    with pytest.raises(rb.SceneError, match="no emitter, so that every image is black"):
        load(sensor=view, shape=shape)
    with pytest.raises(rb.SceneError, match="more than one emitter that surrounds it .*: add up their radiances in one"):
        load(sensor=view, shape=shape, sky=light, more={"type": "constant", "radiance": 2.0})


def test_a_scene_on_a_device_without_numbers():
    with pytest.raises(TypeError, match="is on the device meta, which holds no numbers"):
        rb.render(cornell().to("meta"), spp=1)
