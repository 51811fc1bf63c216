"""The public names: what `torch_radbp.NAME` means."""

from torch_radbp.adjoint import AdjointStrategy, MemoizedAdjoint, QuadraticAdjoint, ReplayAdjoint, TapeAdjoint
from torch_radbp.boundary import JumpWarning, SilhouetteWarning
from torch_radbp.check import GradientCheck, check_gradient
from torch_radbp.io.colmap import cameras_from_colmap
from torch_radbp.io.gltf.document import GltfWarning
from torch_radbp.io.image import save_image
from torch_radbp.io.load import load, load_dict
from torch_radbp.io.nerf import cameras_from_nerf
from torch_radbp.io.write import save
from torch_radbp.photographs import Exposure, LensFalloff, Photograph, Photographs, ToneCurve
from torch_radbp.plugin import SceneError, SceneWarning
from torch_radbp.pose import look_at, se3
from torch_radbp.rendering.call.finite import NonFiniteError
from torch_radbp.rendering.jvp import jvp
from torch_radbp.rendering.noise_watch import RepeatedNoiseWarning
from torch_radbp.rendering.renderer import Renderer, render
from torch_radbp.scene import Scene
from torch_radbp.sensor.opencv import camera_from_opencv, cameras_from_kornia
from torch_radbp.texture.neural import NeuralTexture

__all__ = ["AdjointStrategy", "Exposure", "GltfWarning", "GradientCheck", "JumpWarning", "LensFalloff",
           "MemoizedAdjoint", "NeuralTexture", "NonFiniteError", "Photograph", "Photographs", "QuadraticAdjoint",
           "Renderer", "RepeatedNoiseWarning", "ReplayAdjoint", "Scene", "SceneError", "SceneWarning",
           "SilhouetteWarning", "TapeAdjoint", "ToneCurve", "camera_from_opencv", "cameras_from_colmap",
           "cameras_from_kornia", "cameras_from_nerf", "check_gradient", "jvp", "load", "load_dict", "look_at", "render",
           "save", "save_image", "se3"]
