"""Two optimisations of a plate of glass by its caustic, Mitsuba's and ours: see `benchmarks.caustic`."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call
from torch.nn.functional import conv2d, grid_sample, interpolate, normalize, pad

import torch_radbp as rb
from benchmarks.peers import translated
from benchmarks.scenes.caustic import GLASS, plate_scene, rectangle

PLATE, START = 512, 32  # texels or vertices a side; cells of the first grid
DOUBLES, CALMER = (40, 160, 360, 640), (700, 900)  # steps
RATE, MOST, SPP = 3e-5, 0.01, 32  # of Adam; the bound of heights
NORMALS = "scene.top.bsdf.normalmap.data"


class Loop(Protocol):
    """An optimisation."""

    def step(self, number: int) -> float:
        """Takes a step; the loss before it."""

    def heights(self) -> Tensor:
        """(512, 512) those of the plate."""


class Schedule:
    """Samples and rate of the steps to come."""

    spp, rate = SPP, RATE

    def calms(self, number: int) -> bool:
        """True if this step begins with twice the samples by half the rate."""
        if number in CALMER:
            self.spp, self.rate = 2 * self.spp, self.rate / 2
        return number in CALMER


class OurLoop:
    """The tutorial's loop with a normal map: heights are a thousandth of the way to the floor, so that nothing need move."""

    def __init__(self, picture: Tensor):
        self.picture, self.schedule = picture, Schedule()
        texture = {"type": "bitmap", "data": as_colours(torch.zeros(PLATE, PLATE)), "raw": True, "wrap_mode": "clamp"}
        glass = {"type": "normalmap", "normalmap": texture, "bsdf": GLASS, "flip_invalid_normals": False,
                 "use_shadowing_function": False}
        side = PLATE / (PLATE - 1)  # with half a texel around, so that texels have their middles at the mesh's vertices
        self.renderer = rb.Renderer(rb.load_dict(plate_scene(rectangle(0, True, side, bsdf=glass))))
        self.begin(torch.zeros(START, START))

    def begin(self, grid: Tensor) -> None:
        """Goes on from a grid, with an optimiser that has seen nothing."""
        self.grid = grid.detach().requires_grad_()
        self.optimizer = torch.optim.Adam([self.grid], lr=self.schedule.rate)

    def step(self, number: int) -> float:
        if number in DOUBLES:
            self.begin(larger(self.grid.detach(), 2 * len(self.grid)))
        if self.schedule.calms(number):
            self.optimizer.param_groups[0]["lr"] = self.schedule.rate
        image = self.image(number)
        with torch.no_grad():  # as many samples again, so that the image has twice those of its derivative
            mean = (image + self.image(number + 10**6)) / 2
        image = image + (mean - image).detach()
        loss = (image / image.detach().mean() - self.picture).square().mean()
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        with torch.no_grad():
            self.grid.clamp_(-MOST, MOST)
        return loss.item()

    def image(self, seed: int) -> Tensor:
        """(PIXELS, PIXELS) grey."""
        normals = {NORMALS: as_colours(at_vertices(self.grid))}
        return functional_call(self.renderer, normals, kwargs={"seed": seed, "spp": self.schedule.spp})[0].mean(0)

    def heights(self) -> Tensor:
        return at_vertices(self.grid.detach())


def at_vertices(grid: Tensor) -> Tensor:
    """(PLATE, PLATE) the values of a grid, whose cells fill the plate, at the vertices of a mesh, from rim to rim."""
    across = torch.linspace(-1, 1, PLATE)
    places = torch.stack(torch.meshgrid(across, across, indexing="xy"), -1)
    return grid_sample(grid[None, None], places[None], padding_mode="border", align_corners=False)[0, 0]


def larger(grid: Tensor, size: int) -> Tensor:
    """(size, size) a grid between whose values lie straight lines."""
    return interpolate(grid[None, None], size=(size, size), mode="bilinear")[0, 0]


# The slope along u at a vertex, by heights around: that of its six faces, weighted by their angles. Along v: transposed.
SLOPE = torch.tensor([[0.0, -1.0, 1.0], [-3.0, 0.0, 3.0], [-1.0, 1.0, 0.0]]) / 8


def as_colours(heights: Tensor) -> Tensor:
    """(PLATE, PLATE, 3) the texels of a normal map, one at each vertex of a plate of 2 x 2: the normals of a smooth mesh."""
    around = pad(heights[None, None], (1, 1, 1, 1), mode="replicate") * ((PLATE - 1) / 2)
    slopes = conv2d(around, torch.stack([SLOPE, SLOPE.T])[:, None])[0]
    return (normalize(torch.stack([-slopes[0], -slopes[1], torch.ones_like(heights)], -1), dim=-1) + 1) / 2


class MitsubaPlate:
    """Mitsuba's scene, whose plate is a mesh."""

    def __init__(self, mi, folder: Path):
        import drjit as dr

        self.mi, self.ravel = mi, dr.ravel
        across = np.linspace(-1, 1, PLATE, dtype=np.float32)
        x, z = (each.ravel() for each in np.meshgrid(across, -across))
        number = np.arange(PLATE * PLATE).reshape(PLATE, PLATE)
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        faces = np.concatenate([np.stack(each, -1).reshape(-1, 3) for each in ((a, b, c), (b, d, c))])
        mesh = mi.Mesh("top", PLATE * PLATE, len(faces), has_vertex_normals=True, has_vertex_texcoords=True)
        values = mi.traverse(mesh)
        values["vertex_positions"] = np.stack([x, 0 * x, z], -1).ravel()
        values["vertex_texcoords"] = (np.stack([x, -z], -1).ravel() + 1) / 2
        values["faces"] = faces.astype(np.uint32).ravel()
        values.update()
        mesh.write_ply(str(folder / "plate.ply"))
        top = {"type": "ply", "filename": str(folder / "plate.ply"), "bsdf": GLASS}
        # Else both sides of the plate, of equal glass, become one mesh, and its new vertices take the lower one away.
        self.scene = mi.load_dict(translated(mi, plate_scene(top)), optimize=False)
        self.parameters = mi.traverse(self.scene)
        self.key = next(key for key in self.parameters.keys() if key.endswith("vertex_positions"))
        self.flat, self.uv = mi.Vector3f(x, 0 * x, z), mi.Point2f((x + 1) / 2, (1 - z) / 2)

    def move(self, heights) -> None:
        """Gives the vertices their heights."""
        self.parameters[self.key] = self.ravel(self.flat + self.mi.Vector3f(0, 1, 0) * heights)
        self.parameters.update()


class MitsubaLoop:
    """The tutorial's loop."""

    def __init__(self, picture: Tensor, plate: MitsubaPlate):
        import drjit as dr

        self.dr, self.mi, self.plate, self.schedule = dr, plate.mi, plate, Schedule()
        self.picture = self.mi.TensorXf(picture.numpy())
        self.integrator = self.mi.load_dict({"type": "ptracer", "samples_per_pass": 256 * 256, "max_depth": 4,
                                             "hide_emitters": False})
        flat = self.mi.TensorXf(np.zeros((START, START, 1), np.float32))
        self.texture = self.mi.load_dict({"type": "bitmap", "data": flat, "raw": True, "filter_type": "bilinear",
                                          "wrap_mode": "clamp"})
        self.values = self.mi.traverse(self.texture)
        self.values.keep(["data"])
        self.optimizer = self.mi.ad.Adam(lr=RATE, params=self.values)
        self.places = dr.zeros(self.mi.SurfaceInteraction3f, PLATE * PLATE)
        self.places.uv = plate.uv

    def moved(self):
        """Puts the grid on the plate; their heights."""
        self.optimizer["data"] = self.dr.clip(self.optimizer["data"], -MOST, MOST)
        self.values.update(self.optimizer)
        heights = self.texture.eval_1(self.places)
        self.plate.move(heights)
        return heights

    def step(self, number: int) -> float:
        dr, schedule = self.dr, self.schedule
        if number in DOUBLES:
            grid = torch.from_numpy(np.array(self.optimizer["data"]))[..., 0]
            self.optimizer["data"] = self.mi.TensorXf(larger(grid, 2 * len(grid))[..., None].numpy())
        if schedule.calms(number):
            self.optimizer.set_learning_rate(schedule.rate)
        self.moved()
        image = self.mi.render(self.plate.scene, self.plate.parameters, integrator=self.integrator, seed=number,
                               spp=2 * schedule.spp, spp_grad=schedule.spp)
        grey = (image[:, :, 0] + image[:, :, 1] + image[:, :, 2]) / 3
        loss = dr.mean(dr.square(grey / dr.mean(dr.detach(grey), axis=None) - self.picture), axis=None)
        dr.backward(loss)
        self.optimizer.step()
        dr.eval(self.optimizer["data"])
        return float(np.array(loss))

    def heights(self) -> Tensor:
        return torch.from_numpy(np.array(self.moved())).view(PLATE, PLATE)
