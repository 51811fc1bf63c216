"""Parameters at both ends of their ranges, and what `check_gradient` says of their derivatives there.

    python -m tests.check.ends [SEEDS]

prints the verdicts of each, and of derivatives that are made wrong on purpose.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from tests.scenes.quiet import quiet
from torch_radbp.check import GradientCheck
from torch_radbp.check import gradient as check_module
from torch_radbp.rendering.jvp import DualImage

SPP, MAX_DEPTH, SEEDS = 256, 3, 5
MORE = 8192  # samples where one of two materials is sampled with a probability of 0.02, or many directions of a sky
WRONG = 1.25  # the factor of a wrong derivative
PRINCIPLED = ("anisotropic", "clearcoat", "clearcoat_gloss", "flatness", "metallic", "roughness", "sheen", "sheen_tint",
              "spec_tint")
SHEET = ("anisotropic", "flatness", "roughness", "sheen", "sheen_tint", "spec_tint", "spec_trans")


class Ends(NamedTuple):
    """A parameter of a scene, and the ends of its range."""

    build: Callable[[], rb.Scene]
    parameter: str
    low: float = 0.0
    high: float = 1.0
    spp: int = SPP


def in_scene(name: str, parameter: str, low: float = 0.0, high: float = 1.0, spp: int = SPP) -> Ends:
    """A parameter of the subject of a quiet scene."""
    return Ends(lambda: quiet(name, 1), f"subject.{parameter}", low, high, spp)


def in_even_light(parameter: str, **bsdf: Any) -> Ends:
    """A parameter of a rectangle's material under a constant sky."""
    sky, pose = {"type": "constant", "radiance": rgb(1, 0.8, 0.6)}, ((0, 0, 0), 2.0, (0.3, 1, 0.2), 25)
    return Ends(lambda: load(torch.float64, camera=sensor(4), sky=sky, plane=rectangle(*pose, bsdf=bsdf)),
                f"plane.bsdf.{parameter}", spp=MORE)


def blended(second: dict[str, Any]) -> Ends:
    """The weight of a material beside a diffuse one."""
    return in_even_light("weight.value", type="blendbsdf", weight=0.5, first=diffuse(0.2, 0.2, 0.2), second=second)


ENDS = {
    **{f"principled {name}": in_scene("principled", f"{name}.value") for name in PRINCIPLED},
    "principled specular": in_scene("principled", "specular", high=4.0),
    "principled glass": in_scene("principled glass", "spec_trans.value"),
    **{f"principledthin {name}": in_scene("principled sheet", f"{name}.value") for name in SHEET},
    "principledthin diff_trans": in_scene("principled sheet", "diff_trans.value", high=2.0),
    "sunsky albedo": in_scene("sunsky", "albedo.value", spp=MORE),
    "sunsky turbidity": in_scene("sunsky", "turbidity", 1.0, 10.0, MORE),
    "blend of metal and plastic": in_scene("blend", "weight.data", spp=MORE),
    "blend of glass and metal": in_scene("blend of deltas", "weight.value", spp=MORE),
    "blend of glasses": in_scene("blend of glasses", "weight.value"),
    "mask of a leaf": in_scene("mask", "opacity.data", spp=MORE),
    "mask of frosted glass": in_scene("frosted leaf", "opacity.value", spp=MORE),
    "blend of diffuse and metal": blended({"type": "conductor"}), "blend of diffuse and null": blended({"type": "null"}),
    "blend of diffuse and glass": blended({"type": "dielectric"}),
    "mask": in_even_light("opacity.value", type="mask", opacity=0.5, nested=diffuse(0.2, 0.2, 0.2)),
}


def check(ends: Ends, high: bool, seed: int, **settings: Any) -> GradientCheck:
    """`check_gradient` with a parameter at an end of its range."""
    scene = ends.build()
    with torch.no_grad():
        scene.get_parameter(ends.parameter).fill_(ends.high if high else ends.low)
    return rb.check_gradient(scene, ends.parameter, seed=seed, **{
        "spp": ends.spp, "max_depth": MAX_DEPTH, "compile": False} | settings)


def is_wrong(factor: float = WRONG) -> tuple[Callable, Callable]:
    """Forward mode, and the backward pass of `Measurement`, with derivatives that are wrong by a factor."""
    right, backward = check_module.rendering_with_tangent, check_module.Measurement.backward

    def forward(*arguments: Any, **named: Any) -> DualImage:
        image, tangent = right(*arguments, **named)
        return DualImage(image, factor * tangent)

    return forward, lambda *arguments: [factor * value for value in backward(*arguments)]


def main(seeds: int) -> None:
    """Prints the verdicts of right derivatives, and of wrong ones."""
    total, found = Counter(), Counter()
    right = check_module.rendering_with_tangent, check_module.Measurement.backward
    for name, ends in ENDS.items():
        for high in (False, True):
            results = [check(ends, high, seed) for seed in range(seeds)]
            check_module.rendering_with_tangent, check_module.Measurement.backward = is_wrong()
            wrong = [check(ends, high, seed) for seed in range(seeds)]
            check_module.rendering_with_tangent, check_module.Measurement.backward = right
            total.update(result.verdict for result in results)
            found.update(result.verdict for result in wrong)
            errors = " ".join(f"{result.comparison.projections[1].relative_error:+.1%}" for result in results)
            print(f"{name} at {ends.high if high else ends.low:g}: {dict(Counter(result.verdict for result in results))}, "
                  f"off by {errors}; wrong: {dict(Counter(result.verdict for result in wrong))}", flush=True)
    print(f"right derivatives: {dict(total)}\nwrong by {WRONG - 1:.0%}: {dict(found)}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS)
