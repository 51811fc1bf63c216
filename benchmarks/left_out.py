"""How much derivatives lack by what is left out of them: ``python -m benchmarks.left_out``.

Something moves by `reach` to either side, so far that what is left out has happened often. The difference of the two images
is then the mean of derivatives on the way, and what jumps that these lack have added. Printed are, as shares of the
difference, that rest over blocks of 4 x 4 pixels, by absolute values, and what noise alone would make of it at most.

* An ellipsoid with interpolated normals turns about an axis before a lamp: its triangles turn from the lamp one after the
  other, each as a whole.
* A plate moves between a lamp and a floor. A mirror at the end of the floor reflects the light of the lamp to it, but for
  what the plate hides of that.
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, rgb
from tests.scenes.distant_lamps import LAMPS
from tests.scenes.meshes import icosphere
from torch_radbp.io.values.transform import rotate, scale, translate

SIZE, BLOCK = 16, 4  # pixels
DIFFERENCES, DERIVATIVES = 4, 8  # how many are taken
FILM = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}


class Case(NamedTuple):
    """A scene in which the vertices of a shape move."""

    build: Callable[[], rb.Scene]
    name: str  # of what moves
    moved: Callable[[Tensor, float], Tensor]  # from the vertices to where they are after a while
    velocity: Callable[[Tensor], Tensor]  # of these
    reach: float
    max_depth: int
    spp: int  # of a derivative; an image has four times as many


class Lack(NamedTuple):
    """What derivatives lack, as shares of differences."""

    rest: float
    noise: float  # of the rest, at most: derivatives change on the way, too


def turning(triangles: int, lamp: str) -> Case:
    """An ellipsoid of 20 * 4^k triangles that turns about y."""
    vertices, faces = icosphere(round(math.log(triangles / 20, 4)))
    odd = torch.as_tensor(rotate((1, 2, 3), 40), dtype=torch.float64)[:3, :3]
    vertices = vertices @ odd.T * torch.tensor([0.9, 0.6, 0.5], dtype=torch.float64)
    view = {"type": "perspective", "fov": 26, "to_world": look_at((0, 0, 3.5), (0, 0, 0), (0, 1, 0)), "film": FILM}
    ball = {"type": "mesh", "vertex_positions": vertices, "faces": faces, "recompute_normals": True,
            "bsdf": diffuse(0.8, 0.6, 0.4)}

    def turned(home: Tensor, angle: float) -> Tensor:
        return home @ torch.as_tensor(rotate((0, 1, 0), math.degrees(angle))).to(home)[:3, :3].T

    def velocity(at: Tensor) -> Tensor:
        return torch.stack([at[:, 2], torch.zeros_like(at[:, 1]), -at[:, 0]], 1)

    return Case(lambda: load(torch.float32, sensor=view, lamp=LAMPS[lamp], ball=ball), "ball.vertex_positions", turned,
                velocity, 0.05, 2, 64)


def mirrored() -> Case:
    """A floor, a mirror at its end, and a plate before the lamp that lights both."""
    view = {"type": "perspective", "fov": 30, "to_world": look_at((0, -0.3, 3), (0, 0.2, 0), (0, 1, 0)), "film": FILM}
    floor = {"type": "rectangle", "bsdf": diffuse(0.7, 0.8, 0.6)}
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor"},
              "to_world": translate((0, 1, 0.8)) @ rotate((1, 0, 0), 90) @ scale((1, 0.8, 1))}
    corners = torch.tensor([[-0.5, -1.2, 0.3], [0.3, -1.2, 0.3], [0.3, -1.2, 1.1], [-0.5, -1.2, 1.1]])
    plate = {"type": "mesh", "vertex_positions": corners, "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]),
             "bsdf": {"type": "twosided", "one": diffuse(0.2, 0.1, 0.1)}}
    glow = {"type": "rectangle", "to_world": translate((0, -2.2, 0.8)) @ rotate((1, 0, 0), -90) @ scale((1.5, 0.8, 1)),
            "emitter": {"type": "area", "radiance": rgb(4, 5, 6)}}

    def shifted(home: Tensor, way: float) -> Tensor:
        return home + way * velocity(home)

    def velocity(at: Tensor) -> Tensor:
        return torch.tensor([1.0, 0.0, 0.3]).to(at).expand_as(at)

    return Case(lambda: load(torch.float32, sensor=view, floor=floor, mirror=mirror, plate=plate, glow=glow),
                "plate.vertex_positions", shifted, velocity, 0.1, 3, 4096)


def cases() -> dict[str, Case]:
    """The rows of the table."""
    found = {f"{lamp} lamp, {triangles:,} triangles that turn": turning(triangles, lamp)
             for lamp in ("directional", "surface") for triangles in (320, 1280, 5120, 20480)}
    return found | {"plate that a floor sees directly and in a mirror": mirrored()}


def blocks(image: Tensor) -> Tensor:
    return avg_pool2d(image.double(), BLOCK)


def lack(case: Case, samples: float = 1.0) -> Lack:
    """What the derivatives of a case lack; `samples`: times as many as it has."""
    scene, spp = case.build(), max(1, int(samples * case.spp))
    vertices = scene.get_parameter(case.name)
    home = vertices.detach().clone()

    def image(way: float, seed: int) -> Tensor:
        vertices.data = case.moved(home, way)
        with torch.no_grad():
            return rb.render(scene, spp=4 * spp, seed=seed, max_depth=case.max_depth)

    def derivatives() -> Iterator[Tensor]:
        for number in range(DERIVATIVES):
            vertices.data = case.moved(home, case.reach * ((2 * number + 1) / DERIVATIVES - 1))
            yield rb.jvp(scene, {case.name: case.velocity(vertices.detach())}, spp=spp, seed=1000 + number,
                         max_depth=case.max_depth)

    differences = torch.stack([blocks(image(case.reach, seed) - image(-case.reach, seed)) / (2 * case.reach)
                               for seed in range(DIFFERENCES)])
    found = torch.stack([blocks(derivative) for derivative in derivatives()])
    whole = float(differences.mean(0).abs().sum())
    # The absolute value of a normal number of unit variance is sqrt(2 / pi) in the mean.
    spread = torch.sqrt(differences.var(0) / DIFFERENCES + found.var(0) / DERIVATIVES) * math.sqrt(2 / math.pi)
    return Lack(float((differences.mean(0) - found.mean(0)).abs().sum()) / whole, float(spread.sum()) / whole)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="rows that have this in their names")
    only = parser.parse_args().only
    warnings.simplefilter("ignore", rb.SilhouetteWarning)  # they name what is measured here
    print("| what moves | lacks | by noise alone |\n|---|---|---|")
    for name, case in cases().items():
        if only in name:
            found = lack(case)
            print(f"| {name} | {found.rest:.1%} | {found.noise:.1%} |", flush=True)


if __name__ == "__main__":
    main()
