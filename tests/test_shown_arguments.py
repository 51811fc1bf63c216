"""What completion and `help` show: every argument of a public function by its name, at runtime and to type checkers."""

import inspect
from typing import get_type_hints

import pytest
import torch

import torch_radbp as rb
from torch_radbp.rendering.settings import RendererSettings
from torch_radbp.sensor.calibrated import Calibrated, CameraAttributes

OF_RENDERER = {"render": rb.render, "jvp": rb.jvp, "check_gradient": rb.check_gradient}
OF_CAMERAS = {"opencv": rb.camera_from_opencv, "kornia": rb.cameras_from_kornia, "colmap": rb.cameras_from_colmap,
              "nerf": rb.cameras_from_nerf, "photographs, nerf": rb.Photographs.from_nerf,
              "photographs, colmap": rb.Photographs.from_colmap}
OF_THE_FILE = {"load": "variables"}  # whose names a scene's file chooses


def shown(function) -> dict[str, inspect.Parameter]:
    return dict(inspect.signature(function).parameters)


@pytest.mark.parametrize("name", rb.__all__)
def test_no_public_function_hides_its_arguments(name):
    thing = getattr(rb, name)
    functions = [thing] if not inspect.isclass(thing) else [
        getattr(thing, each) for each in vars(thing) if not each.startswith("_") and callable(getattr(thing, each))]
    hidden = [each for function in functions for each, parameter in shown(function).items()
              if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)]
    assert hidden == ([OF_THE_FILE[name]] if name in OF_THE_FILE else [])


@pytest.mark.parametrize("name", OF_RENDERER)
def test_the_renderers_settings_are_shown_with_its_defaults(name):
    settings, given = shown(rb.Renderer), shown(OF_RENDERER[name])
    assert set(settings) <= set(given)
    own = {"check_gradient": {"spp": 256, "share_samples": True}}.get(name, {})
    for each, parameter in settings.items():
        if each != "scene":
            assert given[each].default == own.get(each, parameter.default), each
            assert given[each].kind is parameter.KEYWORD_ONLY


@pytest.mark.parametrize("name", OF_CAMERAS)
def test_the_attributes_of_cameras_are_shown(name):
    given = shown(OF_CAMERAS[name])
    assert {"near_clip", "far_clip", "sampler", "rfilter", "scale"} <= set(given)
    assert given["near_clip"].default == shown(Calibrated)["near_clip"].default


def test_type_checkers_know_the_settings_as_the_renderer_has_them():
    expected = get_type_hints(rb.Renderer.__init__)
    assert get_type_hints(RendererSettings) == {name: expected[name] for name in expected if name not in ("scene", "spp")}
    expected = get_type_hints(Calibrated.__init__)
    assert get_type_hints(CameraAttributes) == {name: expected[name] for name in CameraAttributes.__annotations__}


def test_an_attribute_that_no_camera_has_is_named_with_the_nearest():
    with pytest.raises(TypeError, match=r"camera_from_opencv\(\) has no argument 'near'; did you mean 'near_clip'"):
        rb.camera_from_opencv(torch.eye(3), torch.eye(3), torch.zeros(3), 4, 4, near=1.0)
