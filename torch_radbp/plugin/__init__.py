"""Plugins: their base classes, categories, registry and schemas, and the errors of scene descriptions."""

from torch_radbp.plugin.base import (
    BSDF,
    Emitter,
    Film,
    Integrator,
    Medium,
    Phase,
    Plugin,
    ReconstructionFilter,
    Sampler,
    Sensor,
    Shape,
    Texture,
    Volume,
    no_module,
    plugin_categories,
)
from torch_radbp.plugin.errors import SceneError, SceneWarning, nearest, with_article
from torch_radbp.plugin.registry import ABSENT, REGISTRY, absent, register
from torch_radbp.plugin.schema import Attribute, Filename, Matrix4, Point3, TriangleMesh, attributes, options
from torch_radbp.plugin.values import boolean, finite, integer, no_gradient, positive, warn_of_radians

__all__ = ["ABSENT", "BSDF", "REGISTRY", "Attribute", "Emitter", "Filename", "Film", "Integrator", "Matrix4", "Medium",
           "Phase", "Plugin", "Point3", "ReconstructionFilter", "Sampler", "SceneError", "SceneWarning", "Sensor",
           "Shape", "Texture", "TriangleMesh", "Volume", "absent", "attributes", "boolean", "finite", "integer",
           "nearest", "no_gradient", "no_module", "options", "plugin_categories", "positive", "register",
           "warn_of_radians", "with_article"]
