"""The interface between emitters and the path tracer.

An emitter has two parts. Its `LightKind`, a hashable value that names the functions, is static: a scene without a kind pays
nothing for it. What differs from emitter to emitter of a kind stands in the kind's table, a record of columns with one row
for each emitter (of emitters on surfaces: for each triangle). Functions get the table twice: attached, and as the `proposal`
whose values are constants and decide every choice.

The light of an emitter is the texel of a texture (`Light.radiated`), which the tracer reads for all kinds at once, times a
factor; or the kind computes it itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.emitter_bounds import LightBounds
from torch_radbp.plugin import Emitter
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.sampling.spheres import BoundingSphere, rays_to_spheres
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import with_parts
from torch_radbp.tensors.vec import Vec2, Vec3, attached, dot, interpolated

NEAREST = 1e-9  # the least distance that counts; 1 / NEAREST^4 is finite in float32

Table = Any  # a NamedTuple of columns: tensors (R,), and nested records of them; or None


class Pick(NamedTuple):
    """The light selected by next-event estimation, per lane; (N,)."""

    row: Tensor  # int32, row of the kind's table; 0 where a light of another kind was selected
    pmf: Tensor  # probability of the selection
    u: Tensor  # int32 random bits, for a point on the light
    v: Tensor


class Aim(NamedTuple):
    """A point sampled on a light as seen from a surface, or a direction towards a distant light; (N,), attached."""

    d: Vec3  # unit direction towards it
    pdf: Tensor  # solid-angle density, times `Pick.pmf`; of a delta light that probability alone; 0: invalid
    target: Vec3 | None = None  # the point, world space; None: far away
    strength: Tensor | None = None  # factor of the light's texture; None: 1
    uv: Vec2 | None = None  # where to evaluate that texture; None: it is one texel
    attributes: tuple[Vec3, ...] | None = None  # of the mesh, at the point; None: it is on no surface
    radiance: Vec3 | None = None  # instead of the texture times its factor
    weighing: Tensor | None = None  # replaces `pdf` in the weights of multiple importance sampling
    n: Vec3 | None = None  # unit normal of the surface that the point lies on; None: on none


class Surrounding(NamedTuple):
    """The scene and the parts of it that rays from a lamp should reach; detached."""

    around: BoundingSphere  # around the scene
    targets: tuple[BoundingSphere, ...]  # around what rays must meet first; none: rays in all directions are wanted
    clearance: Tensor  # () distance off surfaces at which rays start


class RayNumbers(NamedTuple):
    """The uniform numbers of a lamp's ray beside those of `Pick`, (N,) in [0, 1)."""

    across: Vec2
    target: Tensor
    met: Vec3 | None = None  # world points of surfaces to which the rays are glued, attached; None: they follow their lamp


class ShadowSource(NamedTuple):
    """A light as a caster of shadows, reduced to one point or direction."""

    place: Tensor  # (4,) homogeneous: the position, or middle, of the light; or with 0 at the end the direction towards it
    axis: Tensor  # (3,) it shines only into the half space of this direction; 0: into all directions


class EmittingTriangles(NamedTuple):
    """The table of emitters on surfaces: S triangles, attached."""

    p: tuple[Vec3, Vec3, Vec3]  # (S,) each; vertices, world space
    n: Vec3  # unit geometric normal
    shading: tuple[Vec3, Vec3, Vec3] | None  # unit normals of the vertices; None: all triangles are flat
    smooth: Tensor | None  # bool: shaded with vertex normals; None: so are all, or none
    uv: tuple[Vec2, Vec2, Vec2] | None  # of the vertices; None if no texture reads them
    attributes: tuple[tuple[Vec3, Vec3, Vec3], ...]  # of the vertices: mesh attributes that the textures of emitters read
    inverse_area: Tensor  # 1 / area; 0 of a triangle that is never selected


    def attributes_at(self, row: Tensor, u: Tensor, v: Tensor) -> tuple[Vec3, ...]:
        """The mesh attributes at barycentric coordinates of triangles, attached."""
        return tuple(interpolated(lookup(corners, row), u, v) for corners in self.attributes)


@dataclass(frozen=True)
class LightKind(ABC):
    """The functions of one kind of emitter: sampling, density, bounds."""

    delta: ClassVar[bool] = False  # no extent, or one direction only: BSDF sampling cannot find it
    distant: ClassVar[bool] = False  # a direction rather than a point
    parallel: ClassVar[bool] = False  # a sample shines in one direction, the same everywhere; such are all `distant`
    surround: ClassVar[bool] = False  # see `SurroundKind`
    on_surface: ClassVar[bool] = False  # see `SurfaceKind`
    aimed: ClassVar[bool] = True  # its rays end nowhere abruptly, so that they may follow what they meet
    bounded: ClassVar[bool] = False  # it has a position, and its light falls with the square of the distance: see `bounds`

    def table(self, emitters: Sequence[Light], like: Tensor) -> Table:
        """The table of all emitters of this kind in a scene, attached; `like` gives dtype and device."""
        return stacked([emitter.row() for emitter in emitters], like)

    def bounds(self, table: Table, luminance: Tensor) -> LightBounds:
        """The bounds of the light of each row, detached, in the dtype of `luminance`; only for `bounded` kinds.

        Args:
            table: detached.
            luminance: (rows,) mean of the light's texture.
        """
        raise TypeError(f"{type(self).__name__} has no bounds")

    @abstractmethod
    def aim(self, table: Table, proposal: Table, p: Vec3, pick: Pick) -> Aim:
        """Samples the light in row `pick.row` as seen from the points `p`; attached to the table and to `p`.

        Values and derivatives must be finite in every lane, also where a light of another kind was picked.
        """

    def emit(self, table: Table, proposal: Table, pick: Pick, numbers: RayNumbers, world: Surrounding) -> Aim:
        """Samples a ray that leaves the light in row `pick.row`, if distant through a disc; attached to the table.

        Args:
            numbers: uniform numbers beside those of `pick`; with `met`, of kinds that are `aimed`, the rays' derivatives are
                those of rays to these points, and their density has none.
            world: what rays should reach.

        Returns:
            `d`: the direction in which it leaves, `target`: the point at which it does, `pdf`: their density over solid
            angle and area (over what there is of these), over the cosine if it leaves a surface. The rest as of `aim`.
        """
        if not self.parallel:
            raise TypeError(f"{type(self).__name__} does not say which rays leave it")
        middle, radius = world.around
        middle = middle.map(lambda c: c.expand_as(pick.pmf))
        aim = self.aim(table, proposal, middle, pick)
        p, density, _ = rays_to_spheres(world.targets or (world.around,), aim.d.map(settled), numbers.target, numbers.across)
        # The ray through that point begins outside of the scene, and turns about the point with the light.
        p = p if numbers.met is None else attached(p, numbers.met)
        reach = settled(dot(middle - p, aim.d) + radius)
        return aim._replace(d=-aim.d, target=p + aim.d * reach, pdf=aim.pdf * density)


class SurroundKind(LightKind):
    """An environment ("surround"): rays that leave the scene meet it. A scene has at most one."""

    distant: ClassVar[bool] = True
    parallel: ClassVar[bool] = True
    surround: ClassVar[bool] = True

    def even(self, table: Table) -> bool:
        """True if no small part of the directions sends most of the light; `table`: detached."""
        return False

    @abstractmethod
    def radiance(self, table: Table, d: Vec3) -> Vec3:
        """Radiance that arrives from the unit directions `d`; attached to them and to the table."""

    @abstractmethod
    def weighing(self, proposal: Table, d: Vec3) -> Tensor:
        """The density of `aim` over solid angle for MIS weights, as `Aim.weighing`; attached to `d`."""


class SurfaceKind(LightKind):
    """An emitter on the triangles of a shape; its table is `EmittingTriangles`."""

    on_surface: ClassVar[bool] = True

    def check(self, triangles: EmittingTriangles) -> None:
        """Raises ValueError if the surfaces cannot carry an emitter of this kind."""

    @abstractmethod
    def source(self, middle: Tensor, axis: Tensor) -> ShadowSource:
        """The light as a caster of shadows, reduced to one point or direction.

        Args:
            middle: (3,) of the surface.
            axis: (3,) the mean of its normals; 0 if the surface is closed.
        """

    def sends(self, front: Tensor) -> Tensor:
        """True where light is emitted to a viewer in front of the surface (`front`, bool) or behind it.

        Of kinds that are not `delta`.
        """
        raise TypeError(f"{type(self).__name__} is not seen by chance")

    def density(self, table: EmittingTriangles, row: Tensor, pmf: Tensor, distance: Tensor, cosine: Tensor) -> Tensor:
        """The solid-angle density with which `aim` would sample the point that a ray has hit; attached.

        Of kinds that are not `delta`.

        Args:
            table: gives geometry.
            row: of the triangles.
            pmf: with which they are picked.
            distance: that the ray has come.
            cosine: between the geometric normal and the ray's direction.
        """
        raise TypeError(f"{type(self).__name__} is not found by chance")


class Light(Emitter):
    """Base class of emitter plugins: what an emitter gives to the path tracer.

    Args:
        sampling_weight: relative to that of other emitters; 0: next-event estimation never picks it.
    """

    sampling_weight: float

    def picture_jumps(self) -> tuple[JumpLines, ...]:
        """The lines along which the emitter's projected image is discontinuous."""
        return ()

    def picture_ends(self) -> bool:
        """True if the emitter projects an image at whose border the light is discontinuous."""
        return False

    def kind(self) -> LightKind:
        """The functions that sample and evaluate this kind of emitter."""
        raise TypeError(f"{type(self).__name__} does not define its kind")

    def radiated(self):
        """The texture of the emitted light, or None if the kind computes it."""
        return None

    def row(self) -> Table:
        """The emitter's row of its kind's table: a record of () tensors, attached."""
        raise TypeError(f"{type(self).__name__} does not define its row")

    def source(self) -> ShadowSource | None:
        """The light as a caster of shadows, detached; None: no shadow borders, or `SurfaceKind.source` gives it."""
        return None

    def sampled_whole(self) -> bool:
        """True if light samples reach all light of the emitter; False: some of it only BSDF sampling finds."""
        return self.kind().delta or self.sampling_weight > 0


def stacked(records: Sequence[Table], like: Tensor) -> Table:
    """Stacks records of () tensors into one record of columns; a record that holds columns already is returned as it is."""
    first = records[0]
    if isinstance(first, Tensor):
        column = first if first.ndim else torch.stack(tuple(records))
        return column.to(like) if column.is_floating_point() else column.to(like.device)
    return first if first is None else with_parts(first, [stacked(parts, like) for parts in zip(*records)])
