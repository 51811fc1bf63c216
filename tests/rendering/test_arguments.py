"""What `Renderer` and its call accept for a number, a switch, a sensor: the obvious meaning, or one message."""

import re

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.scenes import cornell, sensor
from torch_radbp.film.hdrfilm import HDRFilm

pytestmark = pytest.mark.hostile

WRONG_TYPES = {
    "half a bounce": ({"max_depth": 2.5}, "max_depth must be an integer, got 2.5"),
    "whole number as float": ({"max_depth": 3.0}, "max_depth must be an integer, got 3.0"),
    "depth as text": ({"max_depth": "6"}, "max_depth must be an integer, got '6'"),
    "depth as truth": ({"max_depth": True}, "max_depth must be an integer, got True"),
    "depth of numpy truth": ({"max_depth": np.True_}, "max_depth must be an integer, got "),
    "half a roulette": ({"rr_depth": 1.5}, "rr_depth must be an integer, got 1.5"),
    "roulette as text": ({"rr_depth": "late"}, "rr_depth must be an integer, got 'late'"),
    "roulette of NaN": ({"rr_depth": float("nan")}, "rr_depth must be an integer, got nan"),
    "nee as text": ({"nee": "no"}, "nee must be True or False, got 'no'"),
    "nee as number": ({"nee": 0}, "nee must be True or False, got 0"),
    "nee as tensor": ({"nee": torch.tensor(True)}, "nee must be True or False, got tensor(True)"),
    "hide_emitters as text": ({"hide_emitters": "x"}, "hide_emitters must be True or False, got 'x'"),
    "hide_emitters as number": ({"hide_emitters": 1}, "hide_emitters must be True or False, got 1"),
    "compile as text": ({"compile": "yes"}, "compile must be True or False, got 'yes'"),
    "compile as number": ({"compile": 2}, "compile must be True or False, got 2"),
    "no sampling": ({"sampling": None}, "sampling=None is not known; known: attached, detached, hybrid"),
    "sampling as number": ({"sampling": 3}, "sampling=3 is not known; known: attached, detached, hybrid"),
    "sampling as list": ({"sampling": ["hybrid"]}, "sampling=['hybrid'] is not known; did you mean 'hybrid'"),
    "chunk as float": ({"chunk": 4096.0}, "chunk must be an integer of at least 1, got 4096.0"),
    "spp of several": ({"spp": [4]}, "spp must be an integer of at least 1, got [4]"),
    "spp of numpy float": ({"spp": np.float32(4)}, "spp must be an integer of at least 1, got "),
    "complex spp": ({"spp": 1j}, "spp must be an integer of at least 1, got 1j"),
}


@pytest.mark.parametrize("settings, message", WRONG_TYPES.values(), ids=WRONG_TYPES)
def test_a_setting_of_the_wrong_type(settings, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        rb.Renderer(cornell(), **settings)


CALLS = {
    "half a seed": ({"seed": 1.5}, "seed must be an integer, got 1.5"),
    "seed as text": ({"seed": "1"}, "seed must be an integer, got '1'"),
    "seed as truth": ({"seed": False}, "seed must be an integer, got False"),
    "half a second seed": ({"seed_grad": 0.5}, "seed_grad must be an integer, got 0.5"),
    "sensor as float": ({"sensors": 0.0}, "sensors: an index must be an integer, got 0.0"),
    "sensor as truth": ({"sensors": True}, "sensors: an index must be an integer, got True"),
    "sensors as floats": ({"sensors": [0.0]}, "sensors: an index must be an integer, got 0.0"),
    "unknown name": ({"sensors": "snesor"}, "the scene has no sensor 'snesor'; did you mean 'sensor'? known: sensor"),
    "unknown name among others": ({"sensors": ["sensor", "cam1"]}, "the scene has no sensor 'cam1'; known: sensor"),
    "index that is not there": ({"sensors": 1}, "sensors must be indices from 0 to 0, got 1"),
    "index from the end": ({"sensors": -1}, "sensors must be indices from 0 to 0, got -1"),
    "no sensor": ({"sensors": ()}, "sensors must be indices from 0 to 0, got ()"),
    "spp of half": ({"spp": 0.5}, "spp must be an integer of at least 1, got 0.5"),
    "spp of infinity": ({"spp": float("inf")}, "spp must be an integer of at least 1, got inf"),
}


@pytest.mark.parametrize("call, message", CALLS.values(), ids=CALLS)
def test_a_call_with_an_argument_of_the_wrong_type(call, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        rb.Renderer(cornell(), spp=1)(**call)


FILMS = {
    "half a pixel": ({"width": 4.5}, "width must be an integer, got 4.5"),
    "no pixel": ({"height": 0}, "height must be at least 1, got 0"),
    "half a crop": ({"crop_width": 2.5}, "crop_width must be an integer, got 2.5"),
    "offset as text": ({"crop_offset_x": "1"}, "crop_offset_x must be an integer, got '1'"),
    "crop beyond the image": ({"width": 4, "crop_offset_x": 5}, "crop_width must be at least 1, got -1"),
    "border as text": ({"sample_border": "no"}, "sample_border must be True or False, got 'no'"),
}


@pytest.mark.parametrize("attributes, message", FILMS.values(), ids=FILMS)
def test_a_film_of_the_wrong_type(attributes, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        HDRFilm(**attributes)


def test_integers_of_numpy_and_torch_are_integers():
    scene = cornell()
    expected = rb.Renderer(scene, spp=2, max_depth=3, rr_depth=2, chunk=16)(seed=5, sensors=[0])
    renderer = rb.Renderer(scene, spp=np.int64(2), max_depth=np.int32(3), rr_depth=torch.tensor(2), chunk=np.uint8(16),
                           nee=np.True_)
    assert torch.equal(renderer(seed=np.int64(5), sensors=np.array([0]), spp=torch.tensor(2)), expected)


def two_cameras(first: int = 4, second: int = 4) -> rb.Scene:
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    return cornell(sensors={
        "first": sensor(origin=(-0.4, 0, 3.5), film=film, sampler={"type": "independent", "sample_count": first}),
        "second": sensor(origin=(0.4, 0, 3.5), film=film, sampler={"type": "independent", "sample_count": second})})


CHOICES = [1, [1], "second", ["second"], np.int64(1), np.array([1]), torch.tensor([1]), torch.tensor(1), (1,), range(1, 2)]


@pytest.mark.parametrize("choice", CHOICES, ids=repr)
def test_a_sensor_is_chosen_by_index_or_by_name(choice):
    renderer = rb.Renderer(two_cameras(), max_depth=2)
    assert torch.equal(renderer(sensors=choice), renderer()[1:])


def test_several_sensors_are_chosen_by_name():
    renderer = rb.Renderer(two_cameras(), max_depth=2)
    assert torch.equal(renderer(sensors=["second", 0]), renderer().flip(0))


def test_the_sensors_that_are_rendered_say_how_many_samples_there_are():
    renderer = rb.Renderer(two_cameras(2, 9), max_depth=2)
    assert torch.equal(renderer(sensors=[1]), renderer(sensors=[1], spp=9))
    assert torch.equal(renderer(sensors="first"), renderer(sensors="first", spp=2))
    assert renderer.memory_plan(sensors=1).kept > renderer.memory_plan(sensors=0).kept


def test_sensors_that_disagree_about_the_samples_are_rendered_only_if_told_how_many():
    renderer = rb.Renderer(two_cameras(2, 9), max_depth=2)
    with pytest.raises(ValueError, match=re.escape("samplers of one sample_count, got [2, 9]; give spp, or render them in "
                                                   "separate calls")):
        renderer()
    assert renderer(spp=1).shape == (2, 3, 4, 4)
    assert rb.Renderer(two_cameras(2, 9), spp=1, max_depth=2)().shape == (2, 3, 4, 4)
