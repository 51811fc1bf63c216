"""`pack`: from the modules of a `Scene` to `SceneTensors`, by ordinary differentiable torch."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.bsdf.kind import Kind
from torch_radbp.bsdf.twosided import TwoSided
from torch_radbp.plugin import BSDF, Texture
from torch_radbp.scene.differentiated import differentiated
from torch_radbp.scene.light_table import Lamp, kinds_of, light_table
from torch_radbp.scene.lookup import TextureBank
from torch_radbp.scene.scene import Scene
from torch_radbp.scene.tensors import Layout, MaterialTable, SceneTensors, TriangleTable
from torch_radbp.shape.surface import Triangles
from torch_radbp.texture.bitmap import WRAP_MODES
from torch_radbp.texture.rgb import RGB
from torch_radbp.vec import Vec2, Vec3, unit_normal


class BankBuilder:
    """Collects textures; each is stored once however often it is used."""

    def __init__(self) -> None:
        self.textures: list[Texture] = []
        self.index: dict[int, int] = {}

    def add(self, texture: Texture) -> int:
        """The index of `texture` in the bank."""
        if id(texture) not in self.index:
            self.index[id(texture)] = len(self.textures)
            self.textures.append(texture)
        return self.index[id(texture)]

    @property
    def has_bitmaps(self) -> bool:
        return any(getattr(texture, "has_coordinates", not isinstance(texture, RGB)) for texture in self.textures)

    def build(self, dtype: torch.dtype, device: torch.device) -> TextureBank:
        textures = self.textures or [RGB(value=0.0)]
        images = [texture.texels().to(dtype=dtype, device=device) for texture in textures]
        sizes = [tuple(image.shape[:2]) for image in images]
        texels = torch.cat([image.reshape(-1, 3) for image in images])
        counts = torch.tensor([0] + [height * width for height, width in sizes]).cumsum(0)[:-1]
        matrices = torch.stack([getattr(texture, "to_uv", torch.eye(4)).to(dtype=dtype, device=device)
                                for texture in textures])

        def integers(values) -> Tensor:
            return torch.as_tensor(values, dtype=torch.int32, device=device)

        def row(k: int) -> Vec3:
            return Vec3(matrices[:, k, 0].contiguous(), matrices[:, k, 1].contiguous(), matrices[:, k, 3].contiguous())

        return TextureBank(
            texels=Vec3.of(texels), offset=integers(counts), width=integers([width for _, width in sizes]),
            height=integers([height for height, _ in sizes]),
            wrap=integers([WRAP_MODES.index(getattr(texture, "wrap_mode", "repeat")) for texture in textures]),
            nearest=torch.tensor([getattr(texture, "filter_type", "nearest") == "nearest" for texture in textures],
                                 device=device), to_u=row(0), to_v=row(1))


def pack(scene: Scene) -> SceneTensors:
    """The tensors of a scene, attached to its parameters.

    Raises:
        ValueError: if a parameter has become NaN or infinite; the message names it.
    """
    check_finite(scene)
    dtype, device = scene.dtype, scene.device
    reflectance, radiance = BankBuilder(), BankBuilder()
    bsdfs = list(scene.bsdfs())
    materials, kinds = material_table(bsdfs, reflectance, device)
    surfaces = [without_flat_normals(shape.oriented()) for shape in scene.shapes]
    counts = [len(surface.faces) for surface in surfaces]
    row = {id(bsdf): index for index, bsdf in enumerate(bsdfs)}
    material = [row[id(shape.bsdf)] for shape in scene.shapes]
    emitted = [-1 if shape.emitter is None else radiance.add(shape.emitter.radiance) for shape in scene.shapes]
    lamps = [Lamp(emitter, radiance.add(emitter.radiated())) for emitter in scene.emitters if emitter.type != "area"]
    layout = Layout(
        bending=any(differentiated(bsdf.textures()[slot].texels()) for bsdf in one_sided(bsdfs)
                    for slot in bsdf.kind().steering),
        shading_normals=any(surface.normals is not None for surface in surfaces),
        light_normals=any(surface.normals is not None and texture >= 0 for surface, texture in zip(surfaces, emitted)),
        back_sides=bool(materials.turned.any()), kinds=kinds, anisotropic=any(kind.oriented for kind in kinds),
        reflectance_bitmaps=reflectance.has_bitmaps, radiance_bitmaps=radiance.has_bitmaps,
        area_lights=any(texture >= 0 for texture in emitted), **kinds_of(lamps))
    needs_uv = layout.reflectance_bitmaps or layout.radiance_bitmaps
    triangles = triangle_table(surfaces, layout.shading_normals, needs_uv, layout.anisotropic, dtype, device)
    repeats = torch.tensor(counts, device=device)
    triangles = triangles._replace(
        material=torch.tensor(material, dtype=torch.int32, device=device).repeat_interleave(repeats),
        radiance=torch.tensor(emitted, dtype=torch.int32, device=device).repeat_interleave(repeats))
    triangles, lights = light_table(scene, triangles, counts, lamps)
    return SceneTensors(triangles, materials, reflectance.build(dtype, device), lights,
                        radiance.build(dtype, device), layout)


def without_flat_normals(surface: Triangles) -> Triangles:
    """The surface without vertex normals if they are those of its faces and nothing can change that."""
    if surface.normals is None or differentiated(surface.normals) or differentiated(surface.vertices):
        return surface
    corner = surface.vertices[surface.faces]
    e1, e2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    face = torch.nn.functional.normalize(torch.linalg.cross(e1, e2), dim=-1)
    flat = (surface.normals[surface.faces] - face[:, None]).abs().max() < 1e-5
    return surface._replace(normals=None) if flat else surface


def check_finite(scene: Scene) -> None:
    """Raises ValueError naming the first parameter that is NaN or infinite."""
    for name, parameter in scene.named_parameters():
        bad = parameter.numel() - int(torch.isfinite(parameter.detach()).sum())
        if bad:
            raise ValueError(f"parameter {name!r} has {bad} of {parameter.numel()} values that are NaN or infinite; "
                             f"a smaller learning rate or bounds may keep it finite")


def material_table(bsdfs: list[BSDF], bank: BankBuilder, device: torch.device) -> tuple[MaterialTable, tuple[Kind, ...]]:
    """The rows of all materials, and the kinds that they are of."""
    two_sided = [isinstance(bsdf, TwoSided) for bsdf in bsdfs]
    rows = one_sided(bsdfs)
    kinds = tuple(dict.fromkeys(bsdf.kind() for bsdf in rows))
    textures = [[bank.add(texture) for texture in bsdf.textures()] for bsdf in rows]
    slots = max((kind.slots for kind in kinds), default=0)

    def column(values, dtype=torch.int32) -> Tensor:
        return torch.tensor(values, dtype=dtype, device=device)

    return MaterialTable(column([kinds.index(bsdf.kind()) for bsdf in rows]),
                         tuple(column([row[k] if k < len(row) else 0 for row in textures]) for k in range(slots)),
                         column([False] * len(bsdfs) + two_sided, torch.bool)), kinds


def one_sided(bsdfs: list[BSDF]) -> list[BSDF]:
    """All materials as seen from the side of the normal, then all from behind."""
    sides = [bsdf.sides() if isinstance(bsdf, TwoSided) else (bsdf, bsdf) for bsdf in bsdfs]
    return [front for front, _ in sides] + [back for _, back in sides]


def geometry(scene: Scene) -> tuple[Tensor, Tensor]:
    """All vertices (V, 3), detached, and faces (F, 3) int32 of a scene, in the order of its triangle table."""
    vertices, faces, first = [], [], 0
    for shape in scene.shapes:
        surface = shape.oriented()
        vertices.append(surface.vertices.detach())
        faces.append(surface.faces + first)
        first += len(surface.vertices)
    if not vertices:
        return torch.zeros(0, 3, dtype=scene.dtype), torch.zeros(0, 3, dtype=torch.int32)
    return torch.cat(vertices), torch.cat(faces).to(torch.int32)


def triangle_table(surfaces: list[Triangles], normals: bool, uv: bool, tangents: bool, dtype: torch.dtype,
                   device: torch.device) -> TriangleTable:
    """Vertices, normals and coordinates of all triangles; materials and lights are filled in by the caller."""
    corners, shading, coordinates = [], [], []
    for surface in surfaces:
        corner = surface.vertices.to(dtype)[surface.faces]
        corners.append(corner)
        if normals:
            if surface.normals is None:
                face = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
                shading.append(torch.nn.functional.normalize(face, dim=-1)[:, None].expand(-1, 3, -1))
            else:
                shading.append(surface.normals.to(dtype)[surface.faces])
        if uv or tangents:
            coordinates.append(corner.new_zeros(len(corner), 3, 2) if surface.uv is None
                               else surface.uv.to(dtype)[surface.faces])
    corner = torch.cat(corners) if corners else torch.zeros(0, 3, 3, dtype=dtype, device=device)
    n = [Vec3.of(torch.cat(shading)[:, k]) for k in range(3)] if shading else [None] * 3
    st = [Vec2.of(torch.cat(coordinates)[:, k]) for k in range(3)] if uv and coordinates else [None] * 3
    p0, e1, e2 = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    along = Vec3.of(growth_of_u(e1, e2, torch.cat(coordinates))) if tangents and coordinates else None
    p0, e1, e2 = Vec3.of(p0), Vec3.of(e1), Vec3.of(e2)
    return TriangleTable(p0, e1, e2, unit_normal(e1.detach(), e2.detach()), *n, *st, along, *[None] * 4)


def growth_of_u(e1: Tensor, e2: Tensor, uv: Tensor) -> Tensor:
    """(T, 3) the unit direction in a triangle in which u grows and v stays; 0 where they do not tell. Attached.

    Args:
        e1, e2: (T, 3) edges from the first vertex.
        uv: (T, 3, 2) coordinates of the vertices.
    """
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    determinant = (d1[:, :1] * d2[:, 1:] - d1[:, 1:] * d2[:, :1]).detach()
    tangent = torch.sign(determinant) * (d2[:, 1:] * e1 - d1[:, 1:] * e2)
    known = (tangent != 0).any(1, keepdim=True)
    return torch.where(known, torch.nn.functional.normalize(torch.where(known, tangent, 1.0), dim=-1), 0.0)
