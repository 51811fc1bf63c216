"""The folder of a run and the files in it.

    recipe.toml              the recipe as used; can be run again from here
    metrics.csv              loss, its terms, learning rate, seconds and parameters of every step
    images/SENSOR_*.png|exr  before, target, after, error; of names see `formats.file_names`
    textures/NAME_*.png      before, recovered, true, for parameters that are pictures; deviations
    parameters.safetensors   recovered values by parameter name
    scene/scene.xml          the scene with the recovered values
    tensorboard/             event files
    checkpoint.safetensors   what `--resume` continues from
    summary.json             result, timing and memory, for programs
    report.html              all of it on one page, for people

Every file but the event files is written atomically. While a process writes into the folder, it holds run.lock there.
"""

import json
import warnings
from pathlib import Path
from typing import Any

import safetensors.torch
from torch import Tensor, nn

import torch_radbp as rb
from torch_radbp.formats.atomic import replacing
from torch_radbp.formats.file_names import file_name
from torch_radbp.formats.image import save_image
from torch_radbp.training.false_colour import false_colour
from torch_radbp.training.recipe import Recipe
from torch_radbp.training.recipe_file import read_recipe, write_recipe
from torch_radbp.training.recovery import checkpoint
from torch_radbp.training.recovery.continuation import MAY_CHANGE, recipe_changes, recipe_fields
from torch_radbp.training.recovery.folder_lock import FolderLock
from torch_radbp.training.recovery.metrics import MetricsFile


class RunFolder:
    """A folder of one run; creating the object touches nothing."""

    def __init__(self, path: Path):
        self.path = Path(path)
        self.metrics = MetricsFile(self.path / "metrics.csv")
        self.checkpoint = self.path / checkpoint.FILE_NAME
        self.report = self.path / "report.html"
        self.lock = FolderLock(self.path)
        self._events = None

    def start(self, recipe: Recipe) -> None:
        """Makes the folder with the recipe as used, and takes its lock.

        Raises:
            FileExistsError: the folder is not empty, or is none.
            FolderInUseError: another process writes into it.
        """
        self._check_empty()
        self.path.mkdir(parents=True, exist_ok=True)
        self.lock.acquire()
        self._check_empty()  # again: of two that start at once, the other may have come and gone
        self.save_recipe(recipe)

    def _check_empty(self) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise FileExistsError(f"{self.path}: is no folder; --out names the folder of the run")
        if self.path.exists() and any(each != self.lock.path for each in self.path.iterdir()):
            raise FileExistsError(f"{self.path} is not empty; choose another --out, or continue that run with --resume")

    def save_recipe(self, recipe: Recipe) -> None:
        write_recipe(recipe, self.path / Recipe.FILE_NAME)

    def check_same_recipe(self, recipe: Recipe) -> None:
        """Raises ValueError if the run was made with a recipe that differs in more than steps and device."""
        used = read_recipe(self.path / Recipe.FILE_NAME, allow_outside=True)
        changes = recipe_changes(recipe_fields(used), recipe_fields(recipe))
        if changes:
            raise ValueError(f"{self.path} was run with another recipe: {'; '.join(changes)}; a resumed run may only change "
                             f"{' and '.join(MAY_CHANGE)}. Use the recipe.toml in that folder, or {checkpoint.START_ANEW}")

    def forget_from(self, step: int) -> None:
        """Cuts metrics.csv back to one row for each step before `step`, and warns if some of them are not there or twice."""
        kept, repeated = self.metrics.truncate(step)
        if repeated:
            warnings.warn(f"{self.metrics.path} held {repeated} rows of steps that it had already; the last of each is kept",
                          stacklevel=2)
        if kept < step:
            held = f"holds {kept} of the {step} steps so far" if self.metrics.path.exists() else "is missing"
            warnings.warn(f"{self.metrics.path} {held}; curves and medians of the report lack those steps", stacklevel=2)

    def log(self, row: dict[str, float]) -> None:
        """Appends a step to metrics.csv and to the event files."""
        self.metrics.append(row)
        if self._events is None:
            # TensorBoard takes seconds to import; a run that fails its checks should not pay for it.
            from torch.utils.tensorboard import SummaryWriter

            self._events = SummaryWriter(str(self.path / "tensorboard"), purge_step=int(row["step"]))
        for key, value in row.items():
            if key != "step":
                self._events.add_scalar(key, value, int(row["step"]))

    def close(self) -> None:
        """Flushes the event files."""
        if self._events is not None:
            self._events.close()
            self._events = None

    def image_path(self, sensor: str, role: str, suffix: str = ".png") -> Path:
        return self.path / "images" / f"{file_name(sensor)}_{role}{suffix}"

    def save_image(self, sensor: str, role: str, image: Tensor, png: Tensor | None = None) -> None:
        """Writes a linear (3, H, W) image as EXR and as PNG; `png` is shown instead of it where given."""
        self._write_picture(self.image_path(sensor, role, ".exr"), image)
        self._write_picture(self.image_path(sensor, role), image if png is None else png)

    def texture_path(self, name: str, role: str) -> Path:
        return self.path / "textures" / f"{file_name(name)}_{role}.png"

    def save_texture(self, name: str, role: str, texture: Tensor) -> None:
        """Writes a texture (H, W, 1 or 3) as a picture."""
        self._write_picture(self.texture_path(name, role), texture.expand(-1, -1, 3).permute(2, 0, 1))

    def save_deviations(self, name: str, deviations: Tensor) -> None:
        """Writes standard deviations of a texture (H, W, 1 or 3) in false colours, the largest brightest."""
        texture = deviations.float().expand(-1, -1, 3).permute(2, 0, 1)
        self._write_picture(self.texture_path(name, "deviations"), false_colour(texture, float(texture.max())))

    def _write_picture(self, path: Path, image: Tensor) -> None:
        path.parent.mkdir(exist_ok=True)
        save_image(path, image)

    def save_parameters(self, values: dict[str, Tensor]) -> None:
        # As bytes, because safetensors' own writer makes a file that only its owner may read.
        data = safetensors.torch.save({name: value.cpu().contiguous() for name, value in values.items()})
        with replacing(self.path / "parameters.safetensors") as partial:
            partial.write_bytes(data)

    def save_scene(self, scene: nn.Module) -> None:
        (self.path / "scene").mkdir(exist_ok=True)
        rb.save(scene, self.path / "scene" / "scene.xml")

    def save_summary(self, summary: dict[str, Any]) -> None:
        with replacing(self.path / "summary.json") as partial:
            partial.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")

    def load_summary(self) -> dict[str, Any]:
        return json.loads((self.path / "summary.json").read_text(encoding="utf-8"))
