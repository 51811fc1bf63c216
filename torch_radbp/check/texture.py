"""`check_texture`: tests whether a texture's values are finite, differentiable and within their range."""

from __future__ import annotations

from typing import Any

import torch

from torch_radbp.check.ends import standing_alone
from torch_radbp.check.finite import differentiable_copy
from torch_radbp.check.lanes import texture_at
from torch_radbp.check.report import Finding, PluginCheck
from torch_radbp.io.build import build_plugin
from torch_radbp.plugin import Texture, integer
from torch_radbp.public_call import public_call
from torch_radbp.rendering.settings import checked_seed
from torch_radbp.tensors.vec import Vec3

FEWEST_PLACES = 1000
CORNERS = (0.0, 0.25, 0.5, 1.0, -1.0, 1 - 2.0**-24, -(2.0**-24), 1e-20, 1e4)  # coordinates u and v
SPREAD = 3.0  # random coordinates lie within this of the origin, so that some wrap around
ROUNDING = 1e-5  # relative, by which interpolated values may leave a range


@public_call
def check_texture(texture: Texture | torch.nn.Module | dict[str, Any], *, low: float | None = None,
                  high: float | None = None, places: int = 20_000, seed: int = 0) -> PluginCheck:
    """Tests whether a texture's values and derivatives are finite, and values within a range if one is given.

        print(rb.check_texture({"type": "bitmap", "filename": "wood.png"}, low=0.0, high=1.0))

    Values are read at random surface coordinates, positions for textures of these, beyond [0, 1] too, and at corners and
    borders; in float32 and float64. Derivatives are those by the place and by the texture's parameters. Attributes of meshes
    are 0.5.

    Args:
        texture: a texture, such as `scene.ball.bsdf.reflectance`, a module that stands for one, or a description; left as
            it is.
        low, high: the range of the values; None: not checked.
        places: how many random ones; at least 1,000.
        seed: of the random numbers; the same seed gives the same outcome.

    Returns:
        The findings (`finite`, `derivatives`, `range`), with figures; its `str()` is a table.

    Raises:
        TypeError: if `texture` is none, or a module returns no tensor or another dtype.
        ValueError: if a module returns a wrong shape, or an argument makes no sense.
        RuntimeError: if a module fails.
    """
    if isinstance(texture, dict):
        texture = build_plugin(texture, "texture")
    elif isinstance(texture, torch.nn.Module) and not isinstance(texture, Texture):
        texture = Texture.of_module(texture)
    if not isinstance(texture, Texture):
        raise TypeError(f"texture must be a texture, a module or a dict that describes one, got a {type(texture).__name__}")
    places, seed = integer("places", places, FEWEST_PLACES), checked_seed("seed", seed)
    by_check: dict[str, Finding] = {}
    for dtype in (torch.float32, torch.float64):
        alone, p = standing_alone(texture).to(dtype).requires_grad_(), differentiable_copy(_places_of(places, seed, dtype))
        with torch.enable_grad():
            for finding in findings(alone, p, low, high):
                if finding.check not in by_check or by_check[finding.check].agrees:
                    by_check[finding.check] = finding
    return PluginCheck(f"texture {texture.type or type(texture).__name__}", tuple(by_check.values()))


def _places_of(count: int, seed: int, dtype: torch.dtype) -> Vec3:
    """Random texture points, and points at special coordinates such as corners and integers."""
    random = (torch.rand(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 2 - 1) * SPREAD
    corners = torch.cartesian_prod(torch.tensor(CORNERS, dtype=torch.float64), torch.tensor(CORNERS, dtype=torch.float64))
    return Vec3.of(torch.cat([random, torch.cat([corners, corners[:, :1]], 1)]).to(dtype))


def findings(texture: Texture, p: Vec3, low: float | None, high: float | None) -> list[Finding]:
    """Tests a texture's values and derivatives, by its parameters and the points, in its dtype."""
    values = texture_at(texture, p).stack()
    least, greatest = values.detach().min().item(), values.detach().max().item()
    bad = (~torch.isfinite(values)).any(1)
    words = f"{len(values)} places, values from {least:.4g} to {greatest:.4g}"
    if bool(bad.any()):
        first = ", ".join(f"{coordinate[bad][0].item():.6g}" for coordinate in p)
        return [Finding("finite", False, f"{int(bad.sum())} of {len(values)} places, the first at ({first}), in "
                        f"{str(values.dtype).removeprefix('torch.')}")]
    results = [Finding("finite", True, words)]
    inputs = {**dict(zip(("u (or x)", "v (or y)", "z"), p)), **dict(texture.named_parameters())}
    slopes = torch.autograd.grad(values.sum(), list(inputs.values()), allow_unused=True) if values.requires_grad else ()
    wrong = [name for name, slope in zip(inputs, slopes) if slope is not None and not bool(torch.isfinite(slope).all())]
    results.append(Finding("derivatives", not wrong, f"by {', '.join(wrong)} are not finite" if wrong else
                           f"by {sum(slope is not None for slope in slopes)} of {len(inputs)} inputs, all finite"))
    if low is not None or high is not None:
        off = max(0.0 if low is None else low - least, 0.0 if high is None else greatest - high)
        allowed = ROUNDING * max(abs(low or 0.0), abs(high or 0.0), abs(least), abs(greatest))
        results.append(Finding("range", off <= allowed, f"values from {least:.6g} to {greatest:.6g}, stated "
                               f"{'any' if low is None else f'{low:g}'} to {'any' if high is None else f'{high:g}'}"))
    return results
