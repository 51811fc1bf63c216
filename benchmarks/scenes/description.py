"""What a scene of the benchmarks is: a description that both renderers load, the gradients to take, and its parts."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import torch_radbp as rb

NO_ROULETTE = 10_000  # an rr_depth that no path reaches: the two renderers play roulette by different rules


Source = Path | dict[str, Any]  # Mitsuba's XML, or its dict with transforms as (4, 4) arrays and files by absolute names


class Setting(NamedTuple):
    """How a scene is rendered."""

    resolution: int  # pixels a side
    spp: int
    max_depth: int


class BenchmarkScene(NamedTuple):
    """A scene for both renderers, and what is measured on it."""

    source: Source
    parameters: tuple[str, ...]
    """The names, as in `mi.traverse`, of what gradients are wanted of."""
    setting: Setting

    def load(self) -> rb.Scene:
        """The scene for this renderer; its `parameters` require gradients."""
        if isinstance(self.source, Path):
            scene = rb.load(self.source, resolution=self.setting.resolution)
        else:
            scene = rb.load_dict(self.source)
        for name in self.parameters:
            scene.get_parameter(name).requires_grad_()
        return scene

    def renderer(self, compiled: bool, **settings) -> rb.Renderer:
        """A renderer of the scene, loaded anew; `settings`: further ones of `rb.Renderer`."""
        _, spp, max_depth = self.setting
        return rb.Renderer(self.load(), spp=spp, max_depth=max_depth, rr_depth=NO_ROULETTE, compile=compiled, **settings)


def with_filter(scene: BenchmarkScene, rfilter: str, folder: Path) -> BenchmarkScene:
    """The same scene, whose films have another reconstruction filter; an XML file is written to `folder`."""
    if isinstance(scene.source, Path):
        return scene._replace(source=rewritten(
            scene.source, folder, rfilter,
            lambda text: re.sub(r'(<rfilter type=")\w+(")', rf"\g<1>{rfilter}\g<2>", text)))

    def replaced(part):
        return {key: {"type": rfilter} if key == "rfilter" else replaced(value) for key, value in part.items()
                } if isinstance(part, dict) else part

    return scene._replace(source=replaced(scene.source))


def without_samplers(scene: BenchmarkScene, folder: Path) -> BenchmarkScene:
    """The same scene, whose sensors name no sampler: each renderer takes its own; an XML file is written to `folder`."""
    return scene._replace(source=with_sampler(scene.source, folder, None))


def with_sampler(source: Source, folder: Path, sampler: str | None) -> Source:
    """The same scene, whose sensors have a sampler of this type, or name none; an XML file is written to `folder`."""
    if isinstance(source, Path):
        def changed(text: str) -> str:
            text = re.sub(r"\s*<sampler\b.*?</sampler>", "", text, flags=re.DOTALL)
            return re.sub(r"(?=<film\b)", f'<sampler type="{sampler}"/>', text) if sampler else text

        return rewritten(source, folder, f"{sampler or 'own'}_sampler", changed)

    def exchanged(part):
        if not isinstance(part, dict):
            return part
        kept = {key: exchanged(value) for key, value in part.items() if key != "sampler"}
        return kept | {"sampler": {"type": sampler}} if sampler and "film" in part else kept

    return exchanged(source)


def rewritten(source: Path, folder: Path, name: str, change: Callable[[str], str]) -> Path:
    """The same scene with another text of its file, in `folder`; the files that it names are named as a whole."""
    text, beside = source.read_text(encoding="utf-8"), source.parent
    text = re.sub(r'(<string name="filename" value=")([^"]+)(")',
                  lambda found: f"{found[1]}{(beside / found[2]).resolve()}{found[3]}", text)
    path = folder / f"{source.stem}_{name}.xml"
    path.write_text(change(text), encoding="utf-8")
    return path


def cotangent(resolution: int) -> np.ndarray:
    """(H, W, 3) derivative of the loss by the image: uneven, so that errors do not cancel, and the same for both peers."""
    y, x = np.mgrid[:resolution, :resolution] / resolution
    pattern = np.stack([1 + np.sin(9 * x + 4 * y), 1.5 + np.cos(7 * y), 0.5 + x * y + np.sin(5 * x)], axis=-1)
    return (pattern / resolution**2).astype(np.float32)


def camera(origin: tuple[float, float, float], target: tuple[float, float, float], fov: float, resolution: int) -> dict:
    """A pinhole camera with a square image and a box filter."""
    pose = rb.look_at(origin, target, (0, 1, 0)).numpy()
    film = {"type": "hdrfilm", "width": resolution, "height": resolution, "pixel_format": "rgb",
            "component_format": "float32", "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": fov, "near_clip": 0.01, "far_clip": 1000.0, "to_world": pose, "film": film,
            "sampler": {"type": "independent", "sample_count": 16}}


def rgb(*value: float) -> dict:
    return {"type": "rgb", "value": list(value)}


def use(name: str) -> dict:
    """A reference to an object of the top level."""
    return {"type": "ref", "id": name}
