"""What a boundary term of lines on surfaces is: one class in one file, registered by one line.

    @boundary_term
    class Stripes(LinesTerm):
        ...

A term says where the lines lie and what moves them. The searches of this folder find the places on them that a camera sees
(`terms/primary.py`), sees in mirrors (`terms/reflections.py`) and that vertices of paths see (`terms/crossed_surfaces.py`),
and what is seen on either side; the warnings ask the terms that are switched off.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple, TypeVar

import torch
from torch import Tensor

from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.call.render_call import RenderCall
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.tensors.lookup import lookup

Term = TypeVar("Term", bound="type[LinesTerm]")


class LinesTerm(ABC):
    """The interface of a kind of lines on surfaces at which emission or reflectance is discontinuous.

    Attributes:
        what: the lines, as a warning names them. They lie where x u + y v + z is an integer, u and v surface coordinates.
    """

    what: ClassVar[str]

    @abstractmethod
    def slide(self, call: RenderCall) -> bool:
        """True if a differentiated parameter moves lines over their surface."""

    @abstractmethod
    def lines(self, rendering: Rendering) -> list[tuple[JumpLines, ...]]:
        """The lines on each shape, attached where they move over it."""

    @abstractmethod
    def sliding(self, rendering: Rendering) -> list[list[str]]:
        """For each shape, the names of the differentiated parameters that move lines over it."""


TERMS: list[LinesTerm] = []  # in the order in which they are asked


def boundary_term(term: Term) -> Term:
    """Class decorator that registers a kind of lines on surfaces, so that discontinuities there are differentiated."""
    TERMS.append(term())
    return term


def lines_slide(call: RenderCall) -> bool:
    """True if lines of any term move over their surface by a differentiated parameter."""
    return any(term.slide(call) for term in TERMS)


def lines_on_shapes(rendering: Rendering, terms: list[LinesTerm] | None = None) -> list[tuple[JumpLines, ...]]:
    """The lines on each shape, of all terms or of given ones."""
    found = [term.lines(rendering) for term in (TERMS if terms is None else terms)]
    return [tuple(dict.fromkeys(lines for own in parts for lines in own)) for parts in zip(*found)]


def names_sliding(rendering: Rendering) -> list[list[str]]:
    """For each shape, the names of the differentiated parameters that move lines of any term over it."""
    return [[name for own in parts for name in own] for parts in zip(*(term.sliding(rendering) for term in TERMS))]


class LineNumbers(NamedTuple):
    """The coefficients of R line families x u + y v + z = integer on surfaces, (R,) float64 each; attached."""

    x: Tensor
    y: Tensor
    z: Tensor

    def level(self, row: Tensor, u: Tensor | None, v: Tensor | None) -> Tensor:
        """The values x u + y v + z at surface coordinates, (N,); where u and v are None, z alone.

        Args:
            row: (N,) int32, indices of line families.
            u, v: (N,) float64.
        """
        z = lookup(self.z, row)
        return z if u is None else lookup(self.x, row) * u + lookup(self.y, row) * v + z


def line_numbers(lines: list[JumpLines], device: torch.device) -> LineNumbers:
    """The coefficients x, y and z of lines x u + y v + z = integer as tensors, (R,) float64, attached."""
    x, y = (torch.tensor(column, dtype=torch.float64, device=device) for column in list(zip(*lines))[:2])
    return LineNumbers(x, y, offsets(lines, device))


def offsets(lines: list[JumpLines], device: torch.device) -> Tensor:
    """The coefficient z of some lines, (R,) float64, attached."""
    moving = any(line.moving is not None for line in lines)
    z = torch.tensor([line.z for line in lines], dtype=torch.float64, device=device)
    if not moving:
        return z
    return torch.stack([own if line.moving is None else line.moving.to(device).double() for own, line in zip(z, lines)])


def lines_move(numbers: LineNumbers | None) -> bool:
    """True if lines have derivatives of their own, apart from those of texture coordinates."""
    return numbers is not None and differentiated(numbers.z)
