"""The slots of materials that take a texture, and what else a material needs that is to have one there."""

from torch_radbp.io.values.attribute_values import options
from torch_radbp.plugin import REGISTRY, Texture, attributes

WHITE = {"type": "diffuse", "reflectance": 0.8}
OTHERS = {"blendbsdf": {"first": WHITE, "second": {"type": "roughconductor", "material": "Au", "alpha": 0.3}},
          "mask": {"nested": WHITE}, "normalmap": {"nested": WHITE}, "bumpmap": {"nested": WHITE}}
SLOTS = [(kind, name) for kind, cls in REGISTRY["bsdf"].items() for name, attribute in attributes(cls).items()
         if Texture in options(attribute.annotation)]
FIRST = {kind: name for kind, name in reversed(SLOTS)}.items()  # of each material
