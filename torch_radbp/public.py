"""The public names: what `torch_radbp.NAME` means, and what of it is stable.

Stable means: a program that uses these names as their docstrings say runs under every later version with the same minor
number; what another minor number changes is in CHANGELOG.md.

    scenes                 Scene, load, load_dict, scene_from_trimesh, asset, save, save_image,
                           NeuralTexture, NeuralVolume
    poses and cameras      look_at, se3, camera_from_opencv, cameras_from_colmap, cameras_from_kornia, cameras_from_nerf
    photographs            Photographs, Photograph, Exposure, LensFalloff, ToneCurve
    images                 Renderer, render, contact_sheet
    derivatives            MemoizedAdjoint, ReplayAdjoint, QuadraticAdjoint, TapeAdjoint, jvp, check_gradient, GradientCheck
    uncertainty            covariance, diagonal_covariance, curvature, next_view, sensitivity
    plugins                check_bsdf, check_emitter, check_texture, PluginCheck
    errors and warnings    SceneError, NonFiniteError, SceneWarning, GltfWarning, SilhouetteWarning, JumpWarning,
                           RepeatedNoiseWarning, ZeroGradientWarning
    torch_radbp.bake       bitmap, mesh
    torch_radbp.losses     two_buffer_l2, two_buffer_relative_l2, two_buffer_log_l2, ssim, lpips, exchange_derivatives,
                           exchanged, masked_mean
    torch_radbp.priors     total_variation, bending, smoothness, white_balance
    torch_radbp.optim      LargeSteps, CoarseToFine, refine, Log, Sigmoid, AdamUniform, GaussNewton, bounded,
                           laplacian_loss, normal_consistency_loss, remesh

So are the names of a scene's parameters, which are Mitsuba's.

Public as a name, to annotate with, but without stable methods: AdjointStrategy, which strategies of one's own derive from.

All else may change with any version, and may be imported all the same, for reading or for a plugin of one's own: other
modules and names, and the bits of an image at a given seed.
"""

import torch_radbp.io.trimesh_out  # noqa: F401 (gives shapes and scenes their to_trimesh)
import torch_radbp.scene.modules.bounds  # noqa: F401 (gives scenes their clamp_)
from torch_radbp.adjoint import AdjointStrategy, MemoizedAdjoint, QuadraticAdjoint, ReplayAdjoint, TapeAdjoint
from torch_radbp.boundary.terms.jump_watch import JumpWarning, SilhouetteWarning
from torch_radbp.call.finite import NonFiniteError
from torch_radbp.check import GradientCheck, PluginCheck, check_bsdf, check_emitter, check_gradient, check_texture
from torch_radbp.formats.contact_sheet import contact_sheet
from torch_radbp.formats.image import save_image
from torch_radbp.io.asset import asset
from torch_radbp.io.colmap import cameras_from_colmap
from torch_radbp.io.gltf.document import GltfWarning
from torch_radbp.io.load import load, load_dict
from torch_radbp.io.nerf import cameras_from_nerf
from torch_radbp.io.opencv import camera_from_opencv, cameras_from_kornia
from torch_radbp.io.trimesh_scene import scene_from_trimesh
from torch_radbp.io.write import save
from torch_radbp.photographs import Exposure, LensFalloff, Photograph, Photographs, ToneCurve
from torch_radbp.plugin import SceneError, SceneWarning
from torch_radbp.pose import look_at, se3
from torch_radbp.rendering.jvp import jvp
from torch_radbp.rendering.noise_watch import RepeatedNoiseWarning
from torch_radbp.rendering.render import render
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.rendering.zero_gradients import ZeroGradientWarning
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.texture.neural import NeuralTexture
from torch_radbp.uncertainty.covariance import covariance, diagonal_covariance
from torch_radbp.uncertainty.curvature import curvature
from torch_radbp.uncertainty.next_view import next_view, sensitivity
from torch_radbp.volume.neural import NeuralVolume

__all__ = ["AdjointStrategy", "Exposure", "GltfWarning", "GradientCheck", "JumpWarning", "LensFalloff", "MemoizedAdjoint",
           "NeuralTexture", "NeuralVolume", "NonFiniteError", "Photograph", "Photographs", "PluginCheck",
           "QuadraticAdjoint", "Renderer", "RepeatedNoiseWarning", "ReplayAdjoint", "Scene", "SceneError", "SceneWarning",
           "SilhouetteWarning", "TapeAdjoint", "ToneCurve", "ZeroGradientWarning", "asset", "camera_from_opencv",
           "cameras_from_colmap", "cameras_from_kornia", "cameras_from_nerf", "check_bsdf", "check_emitter",
           "check_gradient", "check_texture", "contact_sheet", "covariance", "curvature", "diagonal_covariance", "jvp",
           "load", "load_dict", "look_at", "next_view", "render", "save", "save_image", "scene_from_trimesh", "se3",
           "sensitivity"]
