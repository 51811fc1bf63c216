"""Checks of derivatives and plugins.

Of a scene's gradients: finite differences, forward mode and the backward pass compared with each other. Of a plugin: whether
it samples, weights and scatters as it says.
"""

from torch_radbp.check.bsdf import check_bsdf
from torch_radbp.check.emitter import check_emitter
from torch_radbp.check.gradient import check_gradient
from torch_radbp.check.outcome import GradientCheck
from torch_radbp.check.report import Finding, PluginCheck
from torch_radbp.check.texture import check_texture

__all__ = ["Finding", "GradientCheck", "PluginCheck", "check_bsdf", "check_emitter", "check_gradient", "check_texture"]
