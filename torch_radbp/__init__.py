"""torch_radbp: a differentiable path tracer that is a torch module.

The pipeline, in the order of data:

1. `load` / `load_dict` (io/) read a Mitsuba 3 scene into a `Scene` (scene/), a tree of modules with named parameters.
2. `Renderer` (render.py) packs it into flat tensors (scene/pack.py), attached to the parameters by plain torch.
3. `path.py` traces bounces: L_k = E_k + F_k L_{k+1}; rays are cast by raycast/, never differentiated.
4. `adjoint/` walks the bounces back: one local vector-Jacobian product each, with the incident radiance in a memo.
   `adjoint/function.py` is the one `autograd.Function`; `adjoint/schedule.py` says which path states are kept.
5. Images come out as (B, 3, H, W); autograd carries gradients on through `pack` to whatever made the parameters.
"""

from torch_radbp import bsdf, emitter, film, sensor, shape, texture  # noqa: F401 (registers the plugins)
from torch_radbp.adjoint import MemoizedAdjoint, QuadraticAdjoint, ReplayAdjoint, TapeAdjoint
from torch_radbp.adjoint.finite import NonFiniteError
from torch_radbp.boundary import JumpWarning, SilhouetteWarning
from torch_radbp.check import GradientCheck, check_gradient
from torch_radbp.io.load import load, load_dict
from torch_radbp.io.write import save
from torch_radbp.jvp import jvp
from torch_radbp.plugin import SceneError
from torch_radbp.pose import se3
from torch_radbp.render import Renderer, render
from torch_radbp.scene import Scene

__all__ = ["GradientCheck", "JumpWarning", "MemoizedAdjoint", "NonFiniteError", "QuadraticAdjoint", "Renderer",
           "ReplayAdjoint", "Scene", "SceneError", "SilhouetteWarning", "TapeAdjoint", "check_gradient", "jvp", "load",
           "load_dict", "render", "save", "se3"]
