"""Loads scenes: files and dicts in, `Scene` out."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import torch

from torch_radbp.formats.files import unknown_kind
from torch_radbp.formats.leniency import Repairs
from torch_radbp.io.build import build_scene
from torch_radbp.io.gltf.read import read_gltf
from torch_radbp.io.xml_scene import read_scene
from torch_radbp.plugin import SceneError
from torch_radbp.public_call import public_call
from torch_radbp.scene.modules.scene import Scene

CPU = torch.device("cpu")
WORDS = {"true": True, "false": False}  # of a command line
DTYPES = (torch.float32, torch.float64)
READERS: dict[str, Callable[..., Scene]] = {
    ".xml": lambda path, given, *_: build_scene(read_scene(path, given)), ".glb": read_gltf, ".gltf": read_gltf}


@public_call
def load(path: str | os.PathLike, *, allow_outside: bool = False, strict: bool = False, **variables: Any) -> Scene:
    """The scene in a Mitsuba 3 XML file, or in a glTF 2.0 file.

    Its parameters have torch's default dtype, float32 or float64, and lie on the CPU whatever torch's default device is;
    `scene.to()` changes both. `torch.autocast` does not concern it.

    glTF: a material is a `principled` of its name (`gold.roughness.data`), around it `gold_normalmap`, `gold_twosided` and
    `gold_mask` if it asks for them; a primitive is a mesh of its node's name, with vertices of its own wherever a mesh is
    used twice. What cannot be read is said in one `GltfWarning`, and so is what is added to a file without a light or a
    camera. Tangents are not read: they follow from the surface coordinates. Units and extensions:
    `torch_radbp.io.gltf.lamp` and `torch_radbp.io.gltf.extension`.

    What can be left out or repaired of files (a face of two corners, a normal that is NaN, a mesh without area) is, and one
    warning for each kind says how many there are and names the first three.

    Args:
        path: the .xml, .glb or .gltf file; names inside it are relative to its folder.
        allow_outside: glTF: also read images and buffers that do not lie in the folder of the file, or below. XML files
            name such files as they like (`../textures`), as in Mitsuba.
        strict: raise an error about what is left out, repaired or cannot be read, instead of warnings.
        **variables: XML: values for `$name` in the file, `load("scene.xml", spp=64)`; they win over <default>. glTF: what
            such a file leaves open, `resolution` (pixels of the longer side; 512), `spp` (16), `max_depth` (-1), `light`
            (radiance of a constant light, added to those of the file; 1 if it has none), `camera` (False: look at the whole
            scene from the front instead of through the file's cameras), `scene` (the number of one of several), and
            `lumens_per_watt` (1; 683 undoes what Blender's exporter multiplies lights with).

    Raises:
        SceneError: names the file and the place in it, and what is supported.
        TypeError: if torch's default dtype is another, or `allow_outside` or `strict` is neither True nor False.
    """
    strict = WORDS.get(strict, strict) if isinstance(strict, str) else strict
    for name, value in (("allow_outside", allow_outside), ("strict", strict)):
        if not isinstance(value, bool):
            raise TypeError(f"{name} must be True or False, got {value!r:.60}")
    suffix = Path(path).suffix.lower()
    if suffix not in READERS:
        raise SceneError(unknown_kind(path, "scene", (".xml (Mitsuba 3)", ".glb and .gltf (glTF 2.0)")))
    return built(lambda: READERS[suffix](path, variables, allow_outside, strict), strict)


@public_call
def load_dict(description: dict[str, Any], base_dir: str | os.PathLike | None = None, *,
              strict: bool = False) -> Scene:
    """The scene that a Python dict in Mitsuba's vocabulary describes, such as `mitsuba.cornell_box()`.

    Its parameters have torch's default dtype and lie on the CPU, as with `load`.

    Args:
        description: {"type": "scene", "white": {"type": "diffuse", ...}, ...}. A transform is a 4 x 4 array or one of
            Mitsuba's transforms; an object may be a plugin that is already made. An `nn.Parameter` in the place of a texel
            array, a colour, vertices, a position or a transform becomes the scene's own parameter, shared and not copied,
            with its `requires_grad`: gradients reach it. It has to be what the scene keeps: of the default dtype, of the
            parameter's shape (a bitmap (H, W, 3) or (H, W, 1)), in world space (no `to_world` beside vertices, no `radius`
            beside the `to_world` of a sphere). One that would have to be converted, and any other tensor that requires a
            gradient, is refused: load the scene first and hand it over by `torch.func.functional_call` or `parametrize`.
        base_dir: folder of relative file names; the current one if None.
        strict: raise an error about what is left out or repaired of the files, instead of warnings.

    Raises:
        SceneError: names the path of keys, such as light.emitter.radiance, and what is supported.
        TypeError: if torch's default dtype is neither float32 nor float64.
    """
    return built(lambda: build_scene(description, base_dir), strict)


def built(build: Callable[[], Scene], strict: bool) -> Scene:
    """Builds a scene in torch's default dtype, on the CPU; errors as `load` says."""
    dtype = torch.get_default_dtype()
    if dtype not in DTYPES:
        raise TypeError(f"scenes are float32 or float64, but torch's default dtype is {dtype}; load under "
                        f"torch.set_default_dtype(torch.float32)")
    # Where nothing else is asked for, the context only costs: a quarter of the time of many small shapes.
    with nullcontext() if torch.empty(0).device == CPU else CPU, Repairs(strict):
        return build().to(CPU, dtype)
