"""Our side of the derivatives of `derivative_subjects`: by forward mode, float64, without a renderer."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd import forward_ad
from torch.func import functional_call, jvp

from tests.emitter.lanes import cast, detached, light_numbers
from tests.scenes import load, sensor
from tests.scenes.lights import FLOOR
from torch_radbp.connection.light import sample_light
from torch_radbp.interface.texture import TexturePoint, TriangleEdges
from torch_radbp.plugin import BSDF
from torch_radbp.scene.packing.pack import pack
from torch_radbp.tensors.vec import Ray, ShadingFrame, Vec2, Vec3
from torch_radbp.texture.bitmap import reader_of
from torch_radbp.vertex.barycentric_gradients import barycentric_gradients
from torch_radbp.vertex.emission import emitted, emitted_by_surround
from torch_radbp.vertex.interaction import surface_interaction

from .derivative_subjects import PLACES, WI, WO, Subject, objects, tangent

AT = PLACES._replace(**{name: torch.from_numpy(array).double() for name, array in PLACES._asdict().items()})


def axis(*components: float) -> Vec3:
    """The same vector at every place."""
    return Vec3.of(torch.tensor(components, dtype=torch.float64).expand(len(AT.wi), 3))


def flat_surface() -> TexturePoint:
    """The places on the plane through x and y, on which u runs along x and v along y."""
    edges, normal = (axis(1, 0, 0), axis(0, 1, 0)), axis(0, 0, 1)
    grown = barycentric_gradients(ShadingFrame(normal, edges[0]), normal, normal, *edges)
    return TexturePoint(Vec2.of(AT.uv), {}, TriangleEdges(edges, tuple(Vec2(edge.x, edge.y) for edge in edges), {}, grown))


class Material(nn.Module):
    """The values of a material's textures at the places, (slots, N, 3)."""

    def __init__(self, bsdf: BSDF):
        super().__init__()
        self.bsdf, self.point = bsdf, flat_surface()

    def forward(self) -> Tensor:
        found, first = [], torch.zeros(len(AT.wi), dtype=torch.int32)
        for texture in self.bsdf.textures():
            reader = reader_of(texture)
            bank = reader.bank([texture], torch.float64, torch.device("cpu"))
            found.append(reader.read(bank, first, self.point).stack())
        return torch.stack(found)


class Light(nn.Module):
    """What a scene's light answers at the places, (N, C)."""

    def __init__(self, scene, asked: str):
        super().__init__()
        self.scene, self.asked, self.proposal = scene, asked, detached(scene)
        self.ray = Ray(Vec3.of(AT.p), Vec3.of(AT.towards))
        self.hit = cast(scene, self.proposal, self.ray).hit
        self.slides = torch.ones_like(self.hit.prim, dtype=torch.bool)  # along the rays, which are fixed

    def forward(self) -> Tensor:
        tensors = pack(self.scene)
        if self.asked == "lamp":
            light = sample_light(tensors, self.proposal, Vec3.of(AT.p), light_numbers(len(AT.p), 1))
            return torch.cat([light.radiance.stack(), light.d.stack()], 1)
        if self.asked == "surround":
            return emitted_by_surround(tensors, Ray(Vec3.of(AT.p), Vec3.of(AT.wi))).stack()
        return emitted(tensors, self.ray, surface_interaction(tensors, self.ray, self.hit, slides=self.slides)).stack()


class Derivatives(NamedTuple):
    """What one subject answers when something moves."""

    rows: dict[str, np.ndarray]
    """By parameter, and for materials by direction: (N, C), columns as in `COLUMNS`."""
    dark: np.ndarray
    """(N,) bool: a material has neither values nor a density there. In Mitsuba's vectorised variants a roughplastic has a
    density below the horizon, and principled materials from behind, where its scalar variants and its samples have none."""


def subject_of(subject: Subject, folder: Path) -> Material | Light:
    """The module that is asked; files that it needs are written into a folder."""
    description = objects(subject, folder)
    if subject.asked == "bsdf":
        scene = load(sensor=sensor(2), sky={"type": "constant"}, subject={"type": "rectangle", "bsdf": description})
        return Material(scene.subject.bsdf)
    return Light(load(sensor=sensor(2), **FLOOR, **description), subject.asked)


def parameters(module: Material | Light) -> list[str]:
    """The names of the parameters that are moved, as both renderers have them."""
    if isinstance(module, Material):
        return [name for name, _ in module.bsdf.named_parameters() if not is_absent(module.bsdf, name)]
    # Of a shape what its light has: attributes, and the pose of a rectangle. Those of meshes are no parameters in Mitsuba.
    names = [name for name, _ in module.scene.named_parameters() if name.startswith("lamp.")]
    others = ("lamp.bsdf", "lamp.vertex_positions", "lamp.vertex_normals", "lamp.vertex_texcoords")
    if module.scene.lamp.type == "ply":
        others += ("lamp.to_world",)
    return [name for name in names if not name.startswith(others)]


def is_absent(bsdf: BSDF, name: str) -> bool:
    """True for a parameter of principled materials that is zero: in Mitsuba, what depends on it does not exist."""
    owner, _, attribute = name.removesuffix(".value").rpartition(".")
    return bsdf.get_submodule(owner).type.startswith("principled") and not bsdf.get_parameter(name).any()


def derivatives(subject: Subject, folder: Path) -> Derivatives:
    """The derivatives of a subject; files that it needs are written into a folder."""
    module = subject_of(subject, folder)
    if isinstance(module, Material):
        return of_material(module)
    return Derivatives({name: moved(module, f"scene.{name}").numpy() for name in parameters(module)},
                       np.zeros(len(AT.wi), dtype=bool))


def moved(module: nn.Module, name: str) -> Tensor:
    """The derivative of what a module returns as one of its parameters moves along its tangent."""
    value = module.get_parameter(name).detach()
    along = torch.as_tensor(tangent(name, value.numpy()), dtype=torch.float64)
    with forward_ad.dual_level():
        found = functional_call(module, {name: forward_ad.make_dual(value, along)}, ())
        derivative = forward_ad.unpack_dual(found).tangent
    return torch.zeros_like(found) if derivative is None else derivative


def of_material(material: Material) -> Derivatives:
    """The derivatives of a material: all in one pass, as lanes are independent."""
    kind, values = material.bsdf.kind(), material().detach()
    still = torch.zeros_like(values), torch.zeros_like(AT.wi), torch.zeros_like(AT.wo)
    tangents = {name: (moved(material, f"bsdf.{name}"), *still[1:]) for name in parameters(material)}
    tangents |= {WI: (still[0], AT.d_wi, still[2]), WO: (*still[:2], AT.d_wo)}
    count = len(tangents)
    choose, u, v = AT.random.T.repeat(1, count)

    def answers(values: Tensor, wi: Tensor, wo: Tensor) -> Tensor:
        values, wi, wo = tuple(Vec3.of(value) for value in values), Vec3.of(wi), Vec3.of(wo)
        value, density = kind.eval_pdf(values, wi, wo)
        found = torch.cat([value.stack(), density[:, None]], 1)
        if not kind.delta:
            return nn.functional.pad(found, (0, 6))
        choice = kind.choose(tuple(value.detach() for value in values), wi.detach(), choose, u, v)
        weight, direction = kind.specular(values, wi, choice).stack(), kind.sample(values, wi, choice, u, v).stack()
        is_delta = choice.is_delta(kind)[:, None] & (weight > 0).any(1, keepdim=True)
        return torch.cat([found, *(torch.where(is_delta, part, 0.0) for part in (weight, direction))], 1)

    given = values.repeat(1, count, 1), AT.wi.repeat(count, 1), AT.wo.repeat(count, 1)
    along = [torch.cat([each[k] for each in tangents.values()], int(k == 0)) for k in range(3)]
    found, derivative = jvp(answers, given, tuple(along))
    rows = derivative.reshape(count, len(AT.wi), -1).numpy()
    return Derivatives(dict(zip(tangents, rows)), (found[:len(AT.wi), :4] == 0).all(1).numpy())
