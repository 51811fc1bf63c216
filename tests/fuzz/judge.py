"""Loads and renders a mutant and judges what happens.

Right is an image of finite radiance that is not negative, or an error of a documented class that names the file in a line
of reasonable length. What loads without a warning is what the file says (`plain_reading`), and loads strictly, too: what is
left out or changed in silence is a fault, as is everything else.
"""

from __future__ import annotations

import tempfile
import traceback
import warnings
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

import torch_radbp as rb
from tests.fuzz.corpus import NEXT_FILE, take_step
from tests.fuzz.plain_reading import difference
from tests.scenes.networks import mlp, textured
from torch_radbp.io.values.transform import translate
from torch_radbp.sensor.calibrated import Calibrated
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.checkpoint import load_checkpoint
from torch_radbp.training.recovery.continuation import check_state, state_bytes
from torch_radbp.training.recovery.problem import Recovery

MESH_OPTIONS = [{}, {"face_normals": True}, {"recompute_normals": True}, {"flip_tex_coords": True, "flip_normals": True},
                {"emitter": {"type": "area"}}, {"emitter": {"type": "directionalarea"}, "face_normals": True},
                *({"bsdf": bsdf} for bsdf in (
                    {"type": "dielectric"}, {"type": "roughconductor"}, {"type": "roughplastic"},
                    {"type": "normalmap", "normalmap": [0.6, 0.4, 0.9], "nested": {"type": "plastic", "nonlinear": True}},
                    {"type": "mask", "nested": {"type": "blendbsdf", "weight": 0.4, "first": {"type": "plastic"},
                                                "second": {"type": "thindielectric"}}},
                    textured(mlp(2, 3)), textured(mlp(3, 3), "position")))]
# What reads a picture beside the sky and the lamp.
PICTURE_USES: list[Callable[[dict], dict]] = [
    lambda picture: {"type": "plastic", "diffuse_reflectance": picture},
    lambda picture: {"type": "mask", "opacity": picture, "nested": {"type": "diffuse"}},
    lambda picture: {"type": "blendbsdf", "weight": picture, "first": {"type": "diffuse"}, "second": {"type": "conductor"}},
    lambda picture: {"type": "normalmap", "normalmap": picture | {"raw": True}, "nested": {"type": "roughplastic"}},
    lambda picture: {"type": "bumpmap", "heights": picture | {"raw": True}, "nested": {"type": "diffuse"}},
    lambda picture: {"type": "roughconductor", "alpha": picture},
]
REFUSALS = (ValueError, TypeError, OSError, rb.NonFiniteError)
LONGEST_MESSAGE = 3000
STRICT = ("xml", "obj", "ply", "serialized", "gltf", "glb")  # of which what is left out or repaired is said
SIZE = 4  # pixels
SAVED = 8  # one mutant in as many is saved and loaded again


class Verdict(NamedTuple):
    """What became of a mutant."""

    outcome: str  # "loaded", "refused", "refused to render" or "fault"
    kind: str  # of the error; of a fault, what tells it from others
    detail: str


def judge(family: str, path: Path) -> Verdict:
    """Loads and renders the file at `path`; what a format cannot say may be said of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.GltfWarning)
        return judged(family, path)


def judged(family: str, path: Path) -> Verdict:
    """Loads and renders the file at `path`."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            scene = load_mutant(family, path)
    except REFUSALS as error:
        return _refusal(error, path)
    except Exception as error:
        return _fault(error)
    if scene is None:
        return Verdict("loaded", "", "")
    told = any(issubclass(warning.category, (rb.SceneWarning, rb.GltfWarning)) for warning in caught)
    silent = silent_change(family, path, scene, told) if family in STRICT else ""
    if silent:
        return Verdict("fault", "silent change", silent)
    try:
        image = render_small(scene)
        networks = any(isinstance(module, rb.NeuralTexture) for module in scene.modules())  # a file has none
        if zlib.crc32(path.read_bytes()) % SAVED == 0 and not networks:
            check_saved(scene)
            check_saved_as_gltf(scene)
    except REFUSALS as error:
        return Verdict("refused to render", type(error).__name__, str(error))
    except Exception as error:
        return _fault(error)
    if not torch.isfinite(image).all():
        return Verdict("fault", "pixels that are not finite", str(image.flatten().tolist()))
    filters = [sensor.film.rfilter for sensor in scene.sensors]
    signed = any(bool((each.evaluate(torch.linspace(0, each.radius, 256)) < 0).any()) for each in filters)
    if image.min() < 0 and not signed:  # filters with negative lobes ring
        return Verdict("fault", "pixels below 0", str(image.flatten().tolist()))
    return Verdict("loaded", "", "")


def silent_change(family: str, path: Path, scene: rb.Scene, told: bool) -> str:
    """What a scene lacks of its file, or has otherwise, without a warning (`told`); nothing if all is as it should be."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            load_mutant(family, path, strict=True)
    except REFUSALS as error:
        return "" if told else f"loads without a warning, but not strictly: {error}"
    return difference(family, path, scene) if family != "xml" else ""


def load_mutant(family: str, path: Path, strict: bool = False) -> rb.Scene | None:
    """The scene that a file describes or is part of; None for a recipe, which is checked as far as its first step, and
    for a checkpoint, from which one is taken."""
    if family == "toml":
        recipe = read_recipe(path, allow_outside=True)
        try:
            Recovery(recipe)
        except REFUSALS as error:  # about the recipe's parameters or one of its files
            raise ValueError(f"{path}: {error}") from error
        return None
    if family == "checkpoint":
        continued(path)
        return None
    if family in ("xml", "gltf", "glb"):
        return rb.load(path, strict=strict)
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE}
    sensor = {"type": "perspective", "film": film, "to_world": rb.look_at([0.5, 0.4, 3], [0.5, 0.5, 0], [0, 1, 0])}
    scene = {"type": "scene", "sensor": sensor}
    if family in ("colmap", "colmap_binary", "nerf"):
        cameras = rb.cameras_from_nerf(path, scale=0.5) if family == "nerf" else rb.cameras_from_colmap(model_of(path))
        return rb.load_dict({"type": "scene", **cameras, "sky": {"type": "constant"}, "ball": {"type": "sphere"}})
    if family in ("obj", "ply", "serialized"):
        mesh = {"type": family, "filename": str(path), **one_of(MESH_OPTIONS, path)}
        if family == "serialized":
            mesh.pop("flip_tex_coords", None)  # which it lacks
        return rb.load_dict({**scene, "sky": {"type": "constant"}, "mesh": mesh}, strict=strict)
    if family == "vol":
        grid = {"type": "sdfgrid", "filename": str(path), "normals": one_of(("smooth", "analytic"), path)}
        return rb.load_dict({**scene, "sky": {"type": "constant"}, "grid": grid})
    picture = {"type": "bitmap", "filename": str(path)}
    return rb.load_dict({**scene, "sky": {"type": "envmap", "filename": str(path)},
                         "wall": {"type": "rectangle", "emitter": {"type": "area", "radiance": picture}},
                         "sheet": {"type": "rectangle", "to_world": translate((0.8, 0.9, 0.5)),
                                   "bsdf": one_of(PICTURE_USES, path)(picture)}})


def continued(path: Path) -> None:
    """Continues the run whose recipe is beside the checkpoint at `path` by a step."""
    recovery = Recovery(read_recipe(path.parent / "recipe.toml"))
    state = load_checkpoint(path, state_bytes(recovery))
    check_state(path, state, recovery)
    recovery.load_state_dict(state)
    take_step(recovery)


def model_of(path: Path) -> Path:
    """The folder of a COLMAP model whose two files are written in one; beside it."""
    folder = path.with_suffix("")
    folder.mkdir(exist_ok=True)
    cameras, _, images = path.read_bytes().partition(NEXT_FILE)
    for name, content in (("cameras", cameras), ("images", images)):
        (folder / f"{name}{path.suffix}").write_bytes(content)
    return folder


def one_of(choices: Sequence, path: Path):
    """The choice that belongs to the contents of a file."""
    return choices[zlib.crc32(path.read_bytes()) % len(choices)]


def render_small(scene: rb.Scene) -> torch.Tensor:
    """Every sensor's image, of 4 x 4 pixels and one sample each: so few that compiling would take longer."""
    for sensor in scene.sensors:
        film = sensor.film
        film.width = film.height = film.crop_width = film.crop_height = SIZE
        film.crop_offset_x = film.crop_offset_y = 0
    with torch.no_grad():
        return rb.Renderer(scene, spp=1, max_depth=3, compile=False)(seed=0)


def check_saved(scene: rb.Scene) -> None:
    """Raises AssertionError if the scene can be saved and what is saved cannot be loaded, or has other parameters."""
    with tempfile.TemporaryDirectory() as folder:
        rb.save(scene, Path(folder) / "saved.xml")
        try:
            saved = rb.load(Path(folder) / "saved.xml")
        except REFUSALS as error:
            raise AssertionError("what was saved does not load") from error
    # Meshes are saved where their poses put them, recomputed normals as what they are now, and some calibrated cameras as
    # perspective ones.
    others = tuple(f"{name}." for name, sensor in scene.named_sensors.items() if isinstance(sensor, Calibrated))
    ours, theirs = ({name for name, _ in each.named_parameters()
                     if not name.endswith(("to_world", "vertex_normals")) and not name.startswith(others)}
                    for each in (scene, saved))
    if ours != theirs:
        raise AssertionError(f"what was saved has other parameters: {sorted(ours ^ theirs)}")


def check_saved_as_gltf(scene: rb.Scene) -> None:
    """Raises AssertionError if the scene can be saved as glTF and that cannot be loaded."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "saved.glb"
        rb.save(scene, path)
        try:
            if scene.shapes:
                rb.load(path)
        except REFUSALS as error:
            raise AssertionError("what was saved as glTF does not load") from error


def _refusal(error: Exception, path: Path) -> Verdict:
    message = str(error)
    kind = type(error).__name__
    if str(path.parent) not in message and path.name not in message:
        return Verdict("fault", f"{kind} that does not name the file", f"{message[:500]}\n{traceback.format_exc()}")
    if len(message) > LONGEST_MESSAGE:
        return Verdict("fault", f"{kind} of {len(message) // 1000 * 1000} characters", message[:LONGEST_MESSAGE])
    return Verdict("refused", kind, message)


def _fault(error: Exception) -> Verdict:
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "torch_radbp" in frame.filename
              or "training" in frame.filename]
    place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
    text = "".join(traceback.format_exception(error))
    return Verdict("fault", f"{type(error).__name__} at {place}", text[-6000:])
