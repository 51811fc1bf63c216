"""`check_emitter`: tests whether a light's samples and densities agree with its emission.

What arrives at a place from all directions is integrated twice: over cells of the sphere (`sphere.py`), from the radiance
that rays meet, and by samples of the light together with uniform directions, weighted as in rendering (multiple importance
sampling; Veach 1997, section 9.2).
"""

from __future__ import annotations

import copy
import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.utils._pytree import tree_map_only

from torch_radbp.check.ends import standing_alone
from torch_radbp.check.lanes import directions, unit_length_error
from torch_radbp.check.report import Finding, PluginCheck, worst
from torch_radbp.check.scattering import LENGTH, QUADRATURE, SIGMAS
from torch_radbp.check.sphere import COLUMNS, ROWS, Cells, angles
from torch_radbp.connection.light import LightSample, sample_light
from torch_radbp.interface.emitter import Light
from torch_radbp.io.build import build_plugin, build_scene
from torch_radbp.plugin import integer
from torch_radbp.public_call import public_call
from torch_radbp.raycast import make_caster
from torch_radbp.rendering.settings import checked_seed
from torch_radbp.sampling.mis import power_heuristic
from torch_radbp.sampling.warp import UNIFORM_SPHERE_PDF
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.packing.pack import pack
from torch_radbp.scene.tables.light_choice import LightNumbers
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.vec import Ray, Vec3, dot, rows
from torch_radbp.texture.rgb import RGB
from torch_radbp.vertex.emission import emitted_by_surface, emitted_by_surround, pdf_of_surface, pdf_of_surround
from torch_radbp.vertex.interaction import surface_interaction

FEWEST_SAMPLES = 10_000
PLACES = {"before it": (0.2, -0.3, 1.5), "beside it": (1.8, 0.9, 0.6), "close by": (0.3, 0.1, 0.15),
          "behind it": (0.1, 0.4, -0.8)}  # a light that a shape carries is a square of edge 2 around the origin, facing +z
CLOSE = (0.0, 1e-12, 1e-6, 1e-3, 1.0, 1e4)  # distances from the origin at which all must be finite
PARTS = 4  # rows and columns of cells that are counted together
SAME = 1e-3  # relative, between two computations of a density; places of rays are rounded to float32
EXACT_ENOUGH = 0.99  # of the rays; at edges, rounding decides what they meet


class Lit(NamedTuple):
    """A scene with one light and nothing else that emits."""

    tensors: SceneTensors  # detached, float64
    on_surface: bool
    caster: Any


class SeenLight(NamedTuple):
    """The radiance of a light along rays, and its density for MIS weights, (N,)."""

    radiance: Vec3
    weighing: Tensor  # density of light samples for MIS weights


@public_call
def check_emitter(emitter: Light | dict[str, Any], *, samples: int = 50_000, seed: int = 0) -> PluginCheck:
    """Tests whether a light's samples and densities agree with its emission.

        print(rb.check_emitter({"type": "envmap", "filename": "sky.exr"}))

    Checked are, from several places: `samples` are unit directions, towards the point that they name; `weights`, the density
    that a sample names is that of a ray in its direction; `light`, the mean of radiance / density over samples, together
    with what uniform directions find, is the integral of the radiance that rays see, in every part of the sphere; all is
    `finite`, derivatives included, in float32 and float64. A light without extent is found by samples alone, so that there
    is no second computation of what it sends.

    A light of a shape is put on a square of edge 2; where a module gives its radiance, 1 stands for it (see
    `check_texture`).

    Args:
        emitter: a light, such as `scene.sky`, or its description; left as it is.
        samples: of each place; at least 10,000.
        seed: of the random numbers; the same seed gives the same outcome.

    Returns:
        The findings, with figures; its `str()` is a table.

    Raises:
        TypeError: if `emitter` is no light.
        ValueError: if an argument makes no sense, or a value is not in its range.
    """
    if isinstance(emitter, dict):
        emitter = build_plugin(emitter, "emitter")
    if not isinstance(emitter, Light):
        raise TypeError(f"emitter must be a light or a dict that describes one, got a {type(emitter).__name__}")
    samples, seed = integer("samples", samples, FEWEST_SAMPLES), checked_seed("seed", seed)
    kind, alone = emitter.kind(), standing_alone(emitter)
    if kind.on_surface and not alone.radiance.tabulated:
        alone.radiance = RGB(value=torch.ones(()))
    scene = scene_of(alone)
    findings = []
    with torch.no_grad():
        tensors = tree_map_only(Tensor, Tensor.detach, pack(scene))
        vertices, faces = tensors.triangles.vertices.p.stack(), torch.stack(tensors.triangles.corners, 1)
        lit = Lit(tensors, kind.on_surface, make_caster(None, vertices, faces))
        lights = {where: light_from(lit, place, samples, seed) for where, place in PLACES.items()}
        findings.append(worst("samples", [_samples_off(where, light, PLACES[where]) for where, light in lights.items()], ""))
        whole = "without extent: only samples find it"
        cases = {} if kind.delta else lights
        findings.append(worst("weights", [weights_off(lit, where, light) for where, light in cases.items()], whole))
        findings.append(worst("light", [light_off(lit, where, light, seed) for where, light in cases.items()], whole))
    return PluginCheck(f"emitter {emitter.type}", (*findings, _finite_everywhere(scene)))


def scene_of(emitter: Light) -> Scene:
    """A scene for a light, in float64: on a square if it is a surface light, else above a small black one."""
    carried = emitter.kind().on_surface
    square = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
    return build_scene({"type": "scene", "sensor": {"type": "perspective"},
                        "shape": square | ({"emitter": emitter} if carried else {}),
                        **({} if carried else {"light": emitter})}).double()


def light_from(lit: Lit, place: tuple[float, float, float], count: int, seed: int) -> LightSample:
    """Samples the light by next-event estimation as seen from one point, many times."""
    generator = torch.Generator().manual_seed(seed)
    bits = LightNumbers(*torch.randint(-(1 << 31), 1 << 31, (4, count), generator=generator).to(torch.int32).unbind())
    p = Vec3(*(torch.full((count,), c, dtype=torch.float64) for c in place))
    return sample_light(lit.tensors, lit.tensors, p, bits)


def _seen(lit: Lit, where: str, d: Vec3) -> SeenLight:
    """The radiance and MIS density of the light along rays from a point."""
    ray = Ray(Vec3(*(torch.full_like(d.x, c) for c in PLACES[where])), d)
    if not lit.on_surface:
        return SeenLight(emitted_by_surround(lit.tensors, ray), pdf_of_surround(lit.tensors, ray))
    si = surface_interaction(lit.tensors, ray, lit.caster.intersect(ray))
    radiance, weighing = emitted_by_surface(lit.tensors, si), pdf_of_surface(lit.tensors, si, lit.tensors)
    return SeenLight(radiance, torch.where(si.valid & si.front, weighing, 0.0))


def _samples_off(where: str, light: LightSample, place: tuple[float, float, float]) -> tuple[float, str]:
    """The error of sampled directions, in units of what is allowed, and the figures in words."""
    used = (light.pdf > 0).nonzero()[:, 0]
    d = rows(light.d, used)
    off = unit_length_error(d)
    if light.distant is None or not bool(light.distant.any()):
        reach = rows(light.target, used) - Vec3(*(torch.full_like(d.x, c) for c in place))
        apart = d - reach * torch.rsqrt(dot(reach, reach).clamp_min(1e-30))
        off = max(off, float(dot(apart, apart).sqrt().max()) if len(used) else 0.0)
    return off / LENGTH, f"{where}: directions are off by up to {off:.2g}, {len(used) / len(light.pdf):.1%} can be used"


def weights_off(lit: Lit, where: str, light: LightSample) -> tuple[float, str]:
    """The error of samples' densities against those of rays, in units of what is allowed, and the figures in words."""
    used = (light.pdf > 0).nonzero()[:, 0]
    if not len(used):
        return 0.0, f"{where}: no sample can be used"
    of_samples, of_rays = light.weighing[used], _seen(lit, where, rows(light.d, used)).weighing
    off = ((of_samples - of_rays).abs() / of_samples.abs().clamp_min(1e-30)).sort().values
    off = off[int(EXACT_ENOUGH * (len(used) - 1))]
    return float(off) / SAME, f"{where}: the density of samples and that of rays differ by up to {float(off):.2g}"


def light_off(lit: Lit, where: str, light: LightSample, seed: int) -> tuple[float, str]:
    """The error of radiance integrals by light samples against those by rays, in units of what is allowed, and figures."""
    count, used = len(light.pdf), light.pdf > 0
    to_lights = rows(light.d, used.nonzero()[:, 0])
    cells = Cells.around(to_lights, max(count // 200, 1))
    integral = cells.integrals(lambda w: [_brightness(_seen(lit, where, w).radiance)])[0]

    # The two ways in which a path may find the light, each with its weight.
    density = light.pdf.clamp_min(1e-30)
    by_light = _brightness(light.radiance) / density * used * power_heuristic(
        light.weighing.clamp_min(1e-30), torch.full_like(density, UNIFORM_SPHERE_PDF) * light.findable)
    even = directions(count, seed)
    ray = _seen(lit, where, even)
    by_chance = _brightness(ray.radiance) / UNIFORM_SPHERE_PDF * power_heuristic(
        torch.full_like(density, UNIFORM_SPHERE_PDF), ray.weighing)
    cases = []
    groups = part_of_cell(cells), _part_of(light.d), _part_of(even)
    for part in (*groups[0].unique().tolist(), None):
        inside = [torch.ones_like(group, dtype=torch.bool) if part is None else group == part for group in groups]
        total, error = float(integral.value[inside[0]].sum()), float(integral.error[inside[0]].sum())
        parts = [values * to_lights for values, to_lights in zip((by_light, by_chance), inside[1:])]
        mean, spread = sum(float(values.mean()) for values in parts), math.hypot(*(float(values.std()) for values in parts))
        allowed = SIGMAS * spread / count**0.5 + error + QUADRATURE * float(integral.value.sum())
        words = "in all" if part is None else "in the worst part of the sphere"
        cases.append((abs(mean - total) / max(allowed, 1e-30) if mean != total else 0.0,
                      f"{where}: samples find {mean:.4g} {words}, rays {total:.4g}"))
    return max(cases)


def _brightness(radiance: Vec3) -> Tensor:
    """The mean of the colour channels of radiance."""
    return (radiance.x + radiance.y + radiance.z) / 3


def part_of_cell(cells: Cells) -> Tensor:
    """The part of the sphere to which each cell belongs."""
    row, column = cells.row >> cells.level, cells.column >> cells.level
    return row // PARTS * (COLUMNS // PARTS) + column // PARTS


def _part_of(d: Vec3) -> Tensor:
    """The part of the sphere to which each direction belongs."""
    polar, longitude = angles(d)
    row = (polar * (ROWS / PARTS / math.pi)).long().clamp_max(ROWS // PARTS - 1)
    return row * (COLUMNS // PARTS) + (longitude * (COLUMNS / PARTS / (2 * math.pi))).long().clamp_max(COLUMNS // PARTS - 1)


def _finite_everywhere(scene: Scene) -> Finding:
    """The finding on finite values and derivatives, from points at all distances."""
    for dtype in (torch.float32, torch.float64):
        alone = copy.deepcopy(scene).to(dtype).requires_grad_()
        axes = torch.tensor([[0.0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0], [0.6, 0, 0.8]], dtype=dtype)
        p = torch.cat([axes * distance for distance in CLOSE]).requires_grad_()
        with torch.enable_grad():
            tensors = pack(alone)
            for u, v in ((0.0, 0.0), (0.3, 0.7), (1 - 2.0**-24, 1 - 2.0**-24)):
                bits = [torch.full((len(p),), int((number - 0.5) * 2**32), dtype=torch.int32) for number in (0.5, 0.5, u, v)]
                light = sample_light(tensors, tensors, Vec3.of(p), LightNumbers(*bits))
                trouble = first_trouble(light, p, dict(alone.named_parameters()))
                if trouble:
                    words = f"in {str(dtype).removeprefix('torch.')}, u = {u:g}, v = {v:g}: {trouble}"
                    return Finding("finite", False, words)
    return Finding("finite", True, f"values and derivatives, from {len(p)} places")


def first_trouble(light: LightSample, p: Tensor, parameters: dict[str, Tensor]) -> str | None:
    """The first value or derivative of light samples that is not finite, in words; None: all are finite."""
    usable = light.pdf > 1e-30
    arrives = light.radiance * (usable / torch.where(usable, light.pdf, 1.0))
    outputs = {"pdf": light.pdf, "d": light.d.stack(), "radiance": light.radiance.stack(),
               "radiance / pdf": arrives.stack()}
    inputs = {"the place": p, **parameters}
    for name, output in outputs.items():
        bad = ~torch.isfinite(output)
        if bool(bad.any()):
            return f"{name} is {output[bad][0].item()} seen from {p[bad.nonzero()[0, 0]].tolist()}"
        slopes = torch.autograd.grad(output.sum(), list(inputs.values()), retain_graph=True, allow_unused=True) \
            if output.requires_grad else ()
        for what, slope in zip(inputs, slopes):
            if slope is not None and not bool(torch.isfinite(slope).all()):
                return f"the derivative of {name} by {what} is not finite"
    return None
