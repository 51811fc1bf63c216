"""The interface between media and the tracer.

A medium fills what surfaces enclose, or the whole scene if no surface is a boundary. It has two parts, as an emitter has:
its `MediumKind`, a hashable value that names the functions, and a table of its numbers, attached to its parameters. What a
vertex sends along a ray, and the light that reaches it along a connection, counts by the share that media let through:

    L = T(ray) (E + F L'),    E = Le + visible T(connection) Ld

In a medium that scatters the flight of a path may end before the next surface, which is an event of its own
(`path/flight.py`). What a medium itself emits along a ray is looked at in one place of each (`path/volume_emission.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.volume import VolumeKind
from torch_radbp.tensors.vec import Ray, Vec3

Table = Any  # a NamedTuple of columns


class MediumWay(NamedTuple):
    """The segments of rays inside of one medium, (N,) each; detached."""

    length: Tensor
    # Of heterogeneous media an estimate of what is left, by colour (where flights are sampled, divided by the
    # same as `Tracking.beyond`), and the distance from where the ray began to a point picked evenly on the way. Else None.
    left: Vec3 | None = None
    place: Tensor | None = None


class EmissionCandidate(NamedTuple):
    """A point sampled uniformly on each ray's way through heterogeneous media up to now, (N,) each; detached."""

    t: Tensor  # distance to it
    left: Vec3  # there, as in `Tracking`, over the same number
    beyond: Vec3


class Tracking(NamedTuple):
    """Rays that are followed through one heterogeneous medium from collision to collision, (N,) each; detached.

    `left` and `beyond` may be divided by any one number of each lane, such as the probability of what the lane has done.
    """

    t: Tensor  # distance to where they have come
    end: Tensor  # distance to where they scatter; infinite: they have not
    left: Vec3  # the share of light that is left, by colour
    beyond: Vec3  # probability of coming so far, by the colour that decides; where they scatter the density of that
    seed: Tensor  # int32, changes at every step
    running: Tensor  # bool: they go on
    emission: EmissionCandidate | None = None  # None: nobody asks what media emit


@dataclass(frozen=True)
class MediumKind:
    """The functions of one kind of medium; those that follow `transmittance` are called for media that scatter."""

    scatters: ClassVar[bool] = False
    heterogeneous: ClassVar[bool] = False  # free flights are sampled by tracking; else `transmittance` is in closed form
    # Of media that scatter: what they emit, read from the column `emission` of the table; None: they do not.
    emission: VolumeKind | None = field(default=None, kw_only=True)

    def transmittance(self, table: Table, ray: Ray, distance: Tensor) -> Vec3:
        """The share of light that is left after a distance along each ray, (N,), in [0, 1].

        Args:
            table: of the medium, read by `lookup` at row 0; attached, as the result is.
            ray: (N,) world, unit directions; attached where rays carry derivatives, as `distance` is.
            distance: (N,) length of the way through the medium; 1e10 where nothing ends it.
        """
        raise TypeError(f"{type(self).__name__} has no transmittance in closed form")

    def sample_flight(self, table: Table, ray: Ray, way: Tensor, u: Tensor, v: Tensor) -> Tensor:
        """Distances at which paths scatter, (N,), sampled by two random numbers. Detached.

        Args:
            table: of the medium.
            ray: (N,) world, unit directions.
            way: (N,) to the next surface, or boundary; 1e10 where there is none. Distances beyond it count as none.
            u, v: (N,) uniform in [0, 1).
        """
        raise TypeError(f"{type(self).__name__} does not scatter")

    def flight_pdf(self, table: Table, ray: Ray, way: Tensor, distance: Tensor) -> tuple[Vec3, Vec3]:
        """The density with which `sample_flight` samples distances, and the probability that a flight goes farther, (N,).

        By colour: a flight is sampled by the extinction of one of three colours, each with a probability of a third.
        """
        raise TypeError(f"{type(self).__name__} does not scatter")

    def emitted(self, table: Table, p: Vec3) -> Vec3:
        """Radiance emitted per unit of length at points, (N,), by colour; attached."""
        if self.emission is None:
            raise TypeError(f"{type(self).__name__} emits nothing")
        return self.emission.eval(table.emission, p)

    def sample_emission(self, table: Table, ray: Ray, way: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Vec3]:
        """Samples distances at which the medium's emission is evaluated, (N,), with their density over length by each of the
        three colours; detached. Args as for `sample_flight`. For media whose `transmittance` has a closed form."""
        raise TypeError(f"{type(self).__name__} emits nothing")

    def enter(self, table: Table, ray: Ray, segment: Tensor) -> tuple[Tensor, Tensor]:
        """Distances at which rays enter and leave a heterogeneous medium, (N,) each; they miss it if the second is not more.

        Args:
            table, ray: as for `sample_flight`.
            segment: (N,) to where the next surface is, or boundary; 1e10 where there is none.
        """
        raise TypeError(f"{type(self).__name__} is not heterogeneous")

    def track(self, table: Table, ray: Ray, segment: Tensor, v: Tensor, tracking: Tracking, flies: bool) -> Tracking:
        """Follows rays by some steps of delta tracking, or of ratio tracking.

        Args:
            table, ray, segment: as for `enter`.
            v: (N,) chooses the colour that decides, as for `sample_flight`.
            tracking: (N,) the state of the rays so far.
            flies: rays may scatter; else only the transmittance is estimated.
        """
        raise TypeError(f"{type(self).__name__} is not heterogeneous")

    def sampled_for_derivatives(self, table: Table, extent: Tensor, of_image: bool) -> Table:
        """The table of the medium by which paths for the derivative are sampled.

        Args:
            table: of the medium.
            extent: () of the scene.
            of_image: the same paths estimate the image, too.
        """
        return table

    def extinction(self, table: Table, p: Vec3, wi: Vec3) -> Vec3:
        """The extinction of a heterogeneous medium at points for light along directions, (N,) by colour; attached.

        In units of 1 / length: the share of the light that is lost in each unit of length.
        """
        raise TypeError(f"{type(self).__name__} is not heterogeneous")

    def scattering(self, table: Table, p: Vec3, wi: Vec3) -> Vec3:
        """The share of light that is scattered per unit of length at points, (N,), along directions, by colour; attached."""
        raise TypeError(f"{type(self).__name__} does not scatter")

    def phase(self, table: Table, p: Vec3, wi: Vec3, wo: Vec3) -> tuple[Tensor, Tensor]:
        """The phase function, and the density over solid angle of `sample_phase`, (N,) each; attached.

        Args:
            table: of the medium.
            p: (N,) points.
            wi: (N,) unit, towards where the path comes from.
            wo: (N,) unit, in which it goes on.
        """
        raise TypeError(f"{type(self).__name__} does not scatter")

    def sample_phase(self, table: Table, p: Vec3, wi: Vec3, u: Tensor, v: Tensor) -> Vec3:
        """Samples unit directions in the world in which paths go on, (N,); attached."""
        raise TypeError(f"{type(self).__name__} does not scatter")


def colour_chosen(values: Vec3, v: Tensor) -> Tensor:
    """The value of the colour that a random number chooses, (N,)."""
    return torch.where(v * 3.0 < 1.0, values.x, torch.where(v * 3.0 < 2.0, values.y, values.z))


def mean_of_colours(values: Vec3) -> Tensor:
    """The mean over the three colours, (N,)."""
    return (values.x + values.y + values.z) / 3.0
