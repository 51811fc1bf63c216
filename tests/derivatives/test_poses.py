"""Poses, vertices and cameras that are functions of something else: torch carries the renderer's derivative on to it."""

import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.deep import deep_but, deep_but_every
from tests.gradients import cotangent, image_and_gradients, relative_error
from tests.scenes.every_plugin import build

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
SETTINGS = {"spp": 2, "max_depth": 3, "compile": False}  # each scene is like no other
MOVES = {
    "vertices": ("mesh", "subject", "vertex_positions"), "normals": ("mesh", "subject", "vertex_normals"),
    "texture coordinates": ("mesh", "subject", "vertex_texcoords"), "shape's pose": ("disk", "subject", "to_world"),
    "camera's pose": ("perspective", "subject", "to_world"), "field of view": ("perspective", "subject", "x_fov"),
    "pose without perspective": ("orthographic", "subject", "to_world"),
    "aperture": ("thinlens", "subject", "aperture_radius"), "focus": ("thinlens", "subject", "focus_distance"),
    "focal length": ("calibrated", "subject", "fx"), "distortion": ("calibrated", "subject", "k1"),
    "tangential distortion": ("calibrated", "subject", "p2"), "fisheye": ("calibrated fisheye", "subject", "k2"),
    "calibrated pose": ("calibrated fisheye", "subject", "to_world"),
    "principal point": ("perspective", "subject", "principal_point_offset_x"),
    "light's position": ("point", "subject", "position"),
    "lamp's pose": ("area", "subject", "to_world"), "sky's pose": ("envmap", "subject", "to_world"),
    "projector's pose": ("projector", "subject", "to_world"), "index of refraction": ("dielectric", "subject", "eta"),
}


class Doubled(nn.Module):
    """x = 2 y."""

    def forward(self, y):
        return 2 * y

    def right_inverse(self, x):
        return x / 2


@pytest.mark.parametrize("sampling", deep_but(["hybrid"], ["hybrid", "attached"]))
@pytest.mark.parametrize("name, plugin, parameter", deep_but_every(4, MOVES.values()), ids=MOVES)
def test_the_gradient_reaches_what_a_parameter_is_made_of(name, plugin, parameter, sampling):
    path, settings = f"{plugin}.{parameter}", SETTINGS | {"sampling": sampling}
    image, (expected,) = image_and_gradients(build(name), [path], **settings)
    assert torch.isfinite(expected).all() and expected.abs().max() > 0

    scene = build(name)
    parametrize.register_parametrization(scene.get_submodule(plugin), parameter, Doubled())
    original = scene.get_submodule(plugin).parametrizations[parameter].original.requires_grad_()
    rendered = rb.Renderer(scene, **settings)(seed=3)
    assert relative_error(rendered.detach(), image) < 1e-12
    gradient, = torch.autograd.grad(rendered, original, cotangent(image))
    assert relative_error(gradient, 2 * expected) < 1e-12

    scene = build(name)
    half = (scene.get_parameter(path).detach() / 2).requires_grad_()
    rendered = functional_call(rb.Renderer(scene, **settings), {f"scene.{path}": 2 * half}, kwargs={"seed": 3})
    gradient, = torch.autograd.grad(rendered, half, cotangent(image))
    assert relative_error(gradient, 2 * expected) < 1e-12


@pytest.mark.parametrize("name", deep_but(["disk", "perspective"], ["disk", "perspective", "area", "projector"]))
def test_the_gradient_of_a_rigid_motion_is_that_of_its_matrix(name):
    image, (of_matrix,) = image_and_gradients(build(name), ["subject.to_world"], **SETTINGS)
    scene = build(name)
    start = scene.get_parameter("subject.to_world").detach()
    motion = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    pose = rb.se3(motion[0], motion[1]) @ start
    rendered = functional_call(rb.Renderer(scene, **SETTINGS), {"scene.subject.to_world": pose}, kwargs={"seed": 3})
    gradient, = torch.autograd.grad(rendered, motion, cotangent(image))
    # To first order a rotation vector w adds w x column to each column of the pose, and a translation its own last column.
    rotation = torch.linalg.cross(start[:3].T, of_matrix[:3].T).sum(0)
    expected = torch.stack([rotation, of_matrix[:3, 3]])
    assert expected.abs().min() > 0 and relative_error(gradient, expected) < 1e-12
