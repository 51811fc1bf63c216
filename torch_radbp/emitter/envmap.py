"""An environment map: light from an image of the surroundings.

The density with which directions are picked jumps from cell to cell of the image. Weights of multiple importance sampling
must not: where directions of BSDF samples carry derivatives, each jump would be an edge that moves over the samples, of
which a derivative knows nothing (measured: 7% of the derivative of a plane that turns under a bright block). Any weights
that add up to 1 are right, so they are made of a continuous density, `EnvmapKind.weighing`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.attributes import FACTOR, factor, linear_inverse, weight
from torch_radbp.emitter.latitude_longitude import latitude_longitude, local_direction, texels_around
from torch_radbp.interface.emitter import Aim, Light, Pick, SurroundKind
from torch_radbp.interface.texture import LUMINANCE, luminance_weights
from torch_radbp.plugin import Filename, Matrix4, register
from torch_radbp.plugin.domain import AMOUNT, POSE, Domain
from torch_radbp.sampling.grid import GridDistribution, grid_distribution
from torch_radbp.sampling.sampler import fine_unit
from torch_radbp.tensors.asked_later import presumed
from torch_radbp.tensors.differentiated import primal
from torch_radbp.tensors.interleaved import columns_of_rows
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Frame, Vec2, Vec3, dot
from torch_radbp.texture.bitmap import IMAGES, linear_image
from torch_radbp.transforms import transform

EVEN = 4.0  # the mean square of light, over the square of its mean, up to which it is even
LEAST_WEIGHING = 1e-7  # per steradian; keeps quotients of densities finite


class EnvmapTable(NamedTuple):
    """An environment map as a table: R rows of texels, C columns; cells lie between the centres of four texels."""

    texels: Vec3  # (R C,) radiance but for the scale, attached
    scale: Tensor  # (1,) factor of the radiance, attached
    to_local: Frame  # (1,) rows of the matrix from world directions to the image's; attached
    to_world: Frame  # () rows of its inverse, detached
    volume: Tensor  # () absolute value of the determinant of `to_local`, detached
    rows: Tensor  # () int32, R
    columns: Tensor  # () int32, C
    pick: GridDistribution  # distribution of the cells
    brightness: Tensor  # (cells,) to which the density of sampled directions is proportional
    at_texels: Tensor | None  # (R C,) a quarter of that at the texels, for MIS weights; None: their luminance
    to_density: Tensor  # () factor to a density over the solid angle of local directions
    edges: Tensor  # (R,) sin^2(theta / 2) of the rows of texels, from pole to pole

    def place(self, d: Vec3) -> tuple[Vec2, Tensor]:
        """Texture coordinates of world directions, and the local solid angle per solid angle in the world; attached."""
        local, jacobian = local_direction(lookup(self.to_local, torch.zeros_like(d.x, dtype=torch.int32)), d)
        return latitude_longitude(local), jacobian


@dataclass(frozen=True)
class EnvmapKind(SurroundKind):
    """Environment maps: a cell is sampled in proportion to its light, a direction uniformly within the cell."""

    def table(self, emitters: Sequence[Envmap], like: Tensor) -> EnvmapTable:
        emitter, = emitters
        return envmap_table(emitter, like)

    def even(self, table: EnvmapTable) -> bool:
        brightness, total = table.brightness.double(), table.pick.rows[-1].double()
        mean = total / (4.0 * math.pi)  # over the solid angle
        solid_angle = latitudes(int(table.rows), int(table.columns), table.brightness.dtype, brightness.device).solid_angle
        square = (brightness.view(-1, int(table.columns)).square() * solid_angle).sum() / (4.0 * math.pi)
        return bool(square <= EVEN * mean * mean)

    def aim(self, table: EnvmapTable, proposal: EnvmapTable, p: Vec3, pick: Pick) -> Aim:
        # An image has more texels than 24 bits tell apart.
        d, density = sample_direction(proposal, fine_unit(pick.u), fine_unit(pick.v))
        return Aim(d, pick.pmf * density, radiance=self.radiance(table, d), weighing=pick.pmf * self.weighing(proposal, d))

    def radiance(self, table: EnvmapTable, d: Vec3) -> Vec3:
        """Radiance that arrives from directions, bilinearly interpolated."""
        uv, _ = table.place(d)
        around = texels_around(uv, table.rows, table.columns)
        scale = lookup(table.scale, torch.zeros_like(d.x, dtype=torch.int32))
        return around.interpolated(lambda texel: lookup(table.texels, texel)) * scale

    def weighing(self, proposal: EnvmapTable, d: Vec3) -> Tensor:
        """A continuous substitute for `density`, for MIS weights.

        It is proportional to the interpolated image, and almost zero wherever directions are never picked.
        """
        uv, jacobian = proposal.place(d)
        around = texels_around(uv, proposal.rows, proposal.columns)
        if proposal.at_texels is None:
            seen = around.interpolated(lambda texel: lookup(proposal.texels, texel))
            brightness = sum(part * share for part, share in zip(seen, LUMINANCE)).abs()
        else:
            brightness = around.interpolated(lambda texel: lookup(proposal.at_texels, texel))
        return (brightness * (4.0 * proposal.to_density) * jacobian).clamp_min(LEAST_WEIGHING)


def density(table: EnvmapTable, d: Vec3) -> Tensor:
    """The solid-angle density of `sample_direction`, (N,)."""
    uv, jacobian = table.place(d)
    uv, columns = uv.map(Tensor.detach), table.columns
    column = torch.remainder(torch.floor(uv.x * columns - 0.5).to(torch.int32), columns)
    cells = (table.rows - 1).clamp_min(1)  # from pole to pole
    row = torch.minimum((uv.y * cells).to(torch.int32), cells - 1).clamp_min(0)
    return lookup(table.brightness, row * columns + column) * table.to_density * jacobian


def sample_direction(table: EnvmapTable, u: Tensor, v: Tensor) -> tuple[Vec3, Tensor]:
    """Samples unit directions in proportion to the image's light, with their solid-angle density; detached.

    Args:
        table: detached.
        u, v: (N,) uniform numbers, float64 with 32 random bits.
    """
    cell = table.pick.sample(u, v)
    dtype, columns = table.brightness.dtype, table.columns
    # Uniform over solid angle: uniform in sin^2(theta / 2), and in longitude from the centre of a column to the next.
    upper = lookup(table.edges, cell.row)
    h = upper + (lookup(table.edges, cell.row + 1) - upper) * cell.down.to(dtype)
    phi = (cell.across + cell.column + 0.5).to(dtype) * (2.0 * math.pi) / columns
    across = 2.0 * torch.sqrt((h * (1.0 - h)).clamp_min(0.0))
    local = Vec3(across * torch.sin(phi), 1.0 - 2.0 * h, -across * torch.cos(phi))
    d = table.to_world.to_local(local)
    squared = dot(d, d).clamp_min(TINY)
    density = lookup(table.brightness, cell.row * columns + cell.column) * table.to_density
    return d * torch.rsqrt(squared), density * table.volume * squared * torch.sqrt(squared)


class Latitudes(NamedTuple):
    """The rows of texels of an image by latitude and longitude; the same for all images of one size."""

    edges: Tensor  # as of `EnvmapTable`
    solid_angle: Tensor  # (rows of cells, 1) of a cell
    rows: Tensor  # as of `EnvmapTable`
    columns: Tensor


@functools.lru_cache(maxsize=64)
def latitudes(height: int, width: int, dtype: torch.dtype, device: torch.device) -> Latitudes:
    """Computes the rows of texels, as `Latitudes`, of images of one size."""
    edges = torch.sin(torch.linspace(0, math.pi / 2, max(height, 2), dtype=torch.float64, device=device)) ** 2
    return Latitudes(edges.to(dtype), ((4 * math.pi / width) * edges.diff()[:, None]).to(dtype),
                     *(torch.tensor(count, dtype=torch.int32, device=device) for count in (height, width)))


def between_neighbours(texel: Tensor) -> Tensor:
    """(rows of cells, W) the sum over the four corners of each cell between the centres of texels (H, W)."""
    pairs = texel[:-1] + texel[1:] if len(texel) > 1 else texel + texel
    cells = torch.empty_like(pairs)
    torch.add(pairs[:, :-1], pairs[:, 1:], out=cells[:, :-1])
    torch.add(pairs[:, -1], pairs[:, 0], out=cells[:, -1])
    return cells


def envmap_table(emitter: Envmap, like: Tensor) -> EnvmapTable:
    """Builds the table of an environment map: image, pose, and the distribution of the cells between texels.

    A cell is picked in proportion to its solid angle and to the mean luminance of its corners, which is that of the
    interpolated image; inside a cell, directions are uniform over solid angle. A black cell is never picked, since it sends
    no light; the derivatives of its texels come from BSDF sampling. Of a map that is black everywhere, all cells are picked
    uniformly over solid angle.

    Reference: Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", section 12.5.
    """
    data = emitter.data.to(like).expand(-1, -1, 3)
    height, width = data.shape[:2]
    edges, solid_angle, rows, columns = latitudes(height, width, like.dtype, like.device)
    with torch.no_grad():
        texel, at_texels = (primal(data) @ luminance_weights(like.dtype, like.device)).abs_(), None
        brightness = between_neighbours(texel)
        if emitter.mis_compensation:
            average = (brightness * solid_angle).sum() / (4 * math.pi)
            average = average * (1 + 1e-6)  # a map of one value has nothing above it
            brightness, at_texels = (brightness - average).clamp_min(0.0), (texel - 0.25 * average).clamp_min(0.0)
            picked = brightness > 0
            picked = picked & picked.roll(1, 1)
            picked = torch.cat([picked[:1], picked[:-1] & picked[1:], picked[-1:]])[:height]  # all cells around a texel
            at_texels = at_texels * picked
        pick = grid_distribution(brightness * solid_angle)
        if not presumed(pick.rows[-1] > 0, True):
            brightness, at_texels = torch.ones_like(brightness), torch.full_like(texel, 0.25)
            pick = grid_distribution(brightness * solid_angle)
    to_local = linear_inverse(emitter.to_world).to(like)
    return EnvmapTable(
        texels=Vec3(*columns_of_rows(data.reshape(-1, 3))), scale=emitter.scale.to(like).reshape(1),
        to_local=Frame(*(Vec3.of(row[None]) for row in to_local.unbind())),
        to_world=Frame(*(Vec3.of(row) for row in emitter.to_world.detach()[:3, :3].to(like).unbind())),
        volume=torch.linalg.det(to_local.detach()).abs(), rows=rows, columns=columns, pick=pick,
        brightness=brightness.reshape(-1), at_texels=None if at_texels is None else at_texels.reshape(-1),
        to_density=pick.rows[-1].reciprocal().to(like), edges=edges)


@register("emitter", "envmap")
class Envmap(Light):
    """An infinitely distant environment: an image by latitude and longitude.

    The first row lies at the local +y pole, the last at -y: where z points up, as in NeRF data sets, turn it by `to_world`.
    The image is interpolated between the centres of its
    columns, also across the seam, as in Mitsuba (which first enlarges images of fewer than 3 rows or 2 columns; here they
    are read as they are). With a `to_world` that is not rigid, directions are normalised after the transform.

    Parameters: `data` (H, W, 3) linear RGB or (H, W, 1) grey, `scale` (), `to_world` (4, 4). Derivatives: with respect
    to all.

    Args:
        filename: EXR, HDR, PFM, PNG, JPEG, BMP, TGA, WebP or TIFF. Either this or `bitmap`.
        bitmap, data: (H, W), (H, W, 1) or (H, W, 3) linear values, or bytes (uint8) in sRGB; both names mean the same.
        scale: multiplies the image.
        to_world: turns the sky, whose pole is +y otherwise.
        mis_compensation: sample only texels brighter than the average, and leave the rest to BSDF sampling (Karlik et al.
            2019).
    """

    def __init__(self, *, filename: Filename | None = None, bitmap: Tensor | None = None, data: Tensor | None = None,
                 scale: float = 1.0, to_world: Matrix4 | None = None, mis_compensation: bool = False,
                 sampling_weight: float = 1.0):
        super().__init__()
        image = linear_image("an envmap", filename, {"bitmap": bitmap, "data": data})
        AMOUNT.check("data" if data is not None else "bitmap", image)
        self.filename, self.mis_compensation = filename, mis_compensation
        self.channels = image.shape[2]
        self.freeze("data", image)
        self.freeze("scale", factor(scale))
        self.freeze("to_world", transform("to_world", to_world))
        self.sampling_weight = weight(sampling_weight)

    bitmap = None  # resolved into `data`

    def domains(self) -> dict[str, Domain]:
        return {"data": IMAGES[self.channels]._replace(low=0.0), "scale": FACTOR, "to_world": POSE}

    def up(self) -> Tensor:
        return self.to_world.detach()[:3, 1]

    def sampled_whole(self) -> bool:
        return super().sampled_whole() and not self.mis_compensation

    def kind(self) -> EnvmapKind:
        return EnvmapKind()
