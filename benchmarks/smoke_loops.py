"""Loops that find the density of smoke from images: that of Mitsuba's tutorial, its copy, and ours; see `benchmarks.smoke`.

A loop that takes its images from `Images` runs with either renderer. Both load the same file.
"""

from __future__ import annotations

import bisect
import time
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.parametrize import register_parametrization

import torch_radbp as rb

PLUME = Path(__file__).parents[1] / "assets" / "shapes" / "plume.vol"
KEY, THEIR_KEY = "smoke.interior.sigma_t.data", "smoke.interior_medium.sigma_t.data"
START, LEAST, MOST = 0.002, 1e-6, 1.0
COARSE, FINE, FINER = 16, 64, 8  # cells of the two parts of the tutorial; times the samples in the second
RATE, OUR_RATE, END = 0.02, 0.2, 0.05  # of Adam; ours ends at that part of it
GROWS = (8, 16, 32, 64)  # cells of our grid, each for as long
STRAIGHT = 0.06  # weight of `rb.priors.bending` in our loss; of 0.03, 0.06 and 0.1 the best in the grid


class Setup(NamedTuple):
    """What is optimised, and how."""

    scene: Path
    targets: np.ndarray  # (views, H, W, 3)
    spp: int
    rounds: int  # of each part of the tutorial's loop
    fine: int  # cells of the grid at the end


class Run(NamedTuple):
    """Seconds since the start, and the grid then; the first is the start."""

    seconds: list[float]
    grids: list[Tensor]

    def until(self, seconds: float) -> int:
        """The number of the last grid that there was by then."""
        return bisect.bisect(self.seconds, seconds) - 1


class Loop(Protocol):
    """An optimisation."""

    def step(self, number: int, done: float) -> None:
        """A step, or a round over the views; `done`: the share of the seconds that is over."""

    def grid(self) -> Tensor:
        """The density, (Z, Y, X, 1)."""


def scene_file(folder: Path, views: int, resolution: int, scale: float) -> Path:
    """The scene for both renderers; the cameras between the `views` follow these."""
    def sensor(name: str, place: float) -> str:
        angle = 180.0 * place / views - 90.0
        return f"""
  <sensor type="perspective" id="{name}"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/><rotate y="1" angle="{angle}"/>
    </transform>
    <film type="hdrfilm"><integer name="width" value="{resolution}"/><integer name="height" value="{resolution}"/>
      <string name="pixel_format" value="rgb"/><rfilter type="tent"/></film></sensor>"""

    sensors = [sensor(f"view_{k}", k) for k in range(views)] + [sensor(f"between_{k}", k + 0.5) for k in range(views)]
    path = folder / "smoke.xml"
    path.write_text(f"""<scene version="3.0.0">
  <integrator type="prbvolpath"><integer name="max_depth" value="6"/></integrator>{"".join(sensors)}
  <shape type="cube" id="smoke"><bsdf type="null"/>
    <medium type="heterogeneous" name="interior"><float name="scale" value="{scale}"/>
      <volume type="gridvolume" name="sigma_t"><string name="filename" value="{PLUME}"/>
        <transform name="to_world"><scale value="2"/><translate x="-1" y="-1" z="-1"/></transform></volume></medium></shape>
  <emitter type="constant"/>
</scene>
""")
    return path


class MitsubaLoop:
    """The tutorial's loop."""

    def __init__(self, setup: Setup, mi):
        import drjit as dr

        self.mi, self.dr, self.setup, self.spp = mi, dr, setup, setup.spp
        self.targets = [mi.TensorXf(target) for target in setup.targets]
        self.scene = mi.load_file(str(setup.scene))
        self.parameters = mi.traverse(self.scene)
        self.parameters.keep([THEIR_KEY])
        self.parameters[THEIR_KEY] = mi.TensorXf(np.full((COARSE, COARSE, COARSE, 1), START, np.float32))
        self.optimizer = mi.ad.Adam(lr=RATE, params={THEIR_KEY: self.parameters[THEIR_KEY]})
        self.parameters.update(self.optimizer)

    def step(self, number: int, done: float) -> None:
        dr, optimizer, fine = self.dr, self.optimizer, self.setup.fine
        if number == self.setup.rounds:
            optimizer[THEIR_KEY] = dr.upsample(optimizer[THEIR_KEY], shape=(fine, fine, fine))
            self.parameters.update(optimizer)
            self.spp *= FINER
        for view, target in enumerate(self.targets):
            image = self.mi.render(self.scene, self.parameters, sensor=view, spp=self.spp, seed=number + 1)
            dr.backward(dr.mean(dr.square(image - target), axis=None))
            optimizer.step()
            optimizer[THEIR_KEY] = dr.clip(optimizer[THEIR_KEY], LEAST, MOST)
            self.parameters.update(optimizer)
        dr.eval(optimizer[THEIR_KEY])
        dr.sync_thread()

    def grid(self) -> Tensor:
        return torch.from_numpy(np.array(self.parameters[THEIR_KEY]))


class SameLoop:
    """The tutorial's loop with this renderer."""

    def __init__(self, setup: Setup):
        self.setup, self.spp = setup, setup.spp
        self.targets = torch.from_numpy(setup.targets).permute(0, 3, 1, 2).contiguous()
        scene = rb.load(setup.scene)
        self.volume = scene.smoke.interior.sigma_t
        self.begin(torch.full((COARSE, COARSE, COARSE, 1), START))
        self.renderer = rb.Renderer(scene)

    def begin(self, data: Tensor) -> None:
        """Goes on from a grid."""
        self.volume.data = torch.nn.Parameter(data)
        self.optimizer = torch.optim.Adam([self.volume.data], lr=RATE)

    def step(self, number: int, done: float) -> None:
        if number == self.setup.rounds:
            data = self.grid()
            for axis in range(3):
                data = data.repeat_interleave(self.setup.fine // COARSE, axis)
            self.begin(data)
            self.spp *= FINER
        for view, target in enumerate(self.targets):
            self.optimizer.zero_grad()
            image = self.renderer(number * len(self.targets) + view, sensors=view, spp=self.spp)
            (image - target).square().mean().backward()
            self.optimizer.step()
            with torch.no_grad():
                self.volume.data.clamp_(LEAST, MOST)

    def grid(self) -> Tensor:
        return self.volume.data.detach().clone()


class Images(Protocol):
    """Images of a density, by either renderer."""

    volume: Any  # a gridvolume, whose `data` they show

    def __call__(self, number: int, spp: int) -> Tensor:
        """Images of all views, (views, 3, H, W), attached to the density; `number`: of their samples."""


class OurImages:
    """By this renderer."""

    def __init__(self, setup: Setup):
        scene = rb.load(setup.scene)
        self.volume, self.views, self.renderer = scene.smoke.interior.sigma_t, range(len(setup.targets)), rb.Renderer(scene)

    def __call__(self, number: int, spp: int) -> Tensor:
        return self.renderer(number, sensors=self.views, spp=spp)


class MitsubaImages:
    """By Mitsuba's `prbvolpath`."""

    def __init__(self, setup: Setup, mi):
        self.mi, self.views = mi, range(len(setup.targets))
        self.volume = rb.load(setup.scene).smoke.interior.sigma_t
        self.scene = mi.load_file(str(setup.scene))
        self.parameters = mi.traverse(self.scene)

    def __call__(self, number: int, spp: int) -> Tensor:
        return ImagesByMitsuba.apply(self.volume.data, self, number, spp)


class ImagesByMitsuba(torch.autograd.Function):
    """The images of `MitsubaImages`, for torch."""

    @staticmethod
    def forward(ctx, data: Tensor, of: MitsubaImages, number: int, spp: int) -> Tensor:
        import drjit as dr

        ctx.mi, ctx.leaf = of.mi, of.mi.TensorXf(np.ascontiguousarray(data.detach().numpy()))
        dr.enable_grad(ctx.leaf)
        of.parameters[THEIR_KEY] = ctx.leaf
        of.parameters.update()
        seeds = [2 * (number * len(of.views) + view) for view in of.views]
        ctx.images = [of.mi.render(of.scene, of.parameters, sensor=view, spp=spp, seed=seed, seed_grad=seed + 1)
                      for view, seed in enumerate(seeds)]
        images = np.stack([np.array(dr.detach(image)) for image in ctx.images])
        return torch.from_numpy(images).permute(0, 3, 1, 2).contiguous()

    @staticmethod
    def backward(ctx, adj_images: Tensor):
        import drjit as dr

        for image, adjoint in zip(ctx.images, adj_images.permute(0, 2, 3, 1)):
            dr.backward(dr.sum(image * ctx.mi.TensorXf(np.ascontiguousarray(adjoint.numpy())), axis=None))
        return torch.from_numpy(np.array(dr.grad(ctx.leaf))), None, None, None


class OurLoop:
    """From coarse to fine, between 0 and 1, with a prior of bending: what five views leave open is straight, and not noise.

    Args:
        setup: what is optimised.
        images: by either renderer; None: by ours.
    """

    def __init__(self, setup: Setup, images: Images | None = None):
        self.targets = torch.from_numpy(setup.targets).permute(0, 3, 1, 2).contiguous()
        self.images, self.spp = OurImages(setup) if images is None else images, setup.spp
        self.volume = self.images.volume
        self.volume.data = torch.nn.Parameter(torch.full((setup.fine, setup.fine, setup.fine, 1), START))
        self.coarse = rb.optim.CoarseToFine((GROWS[0],) * 3, within=rb.optim.Sigmoid())
        register_parametrization(self.volume, "data", self.coarse)
        self.optimizer = torch.optim.Adam(self.volume.requires_grad_().parameters(), lr=OUR_RATE)

    def step(self, number: int, done: float) -> None:
        if self.coarse.size[0] < GROWS[min(int(done * len(GROWS)), len(GROWS) - 1)]:
            rb.optim.refine(self.volume, "data", self.optimizer)
        self.optimizer.param_groups[0]["lr"] = OUR_RATE * END**done
        self.optimizer.zero_grad()
        loss = (self.images(number, self.spp) - self.targets).square().mean()
        (loss + STRAIGHT * rb.priors.bending(self.volume.data)).backward()
        self.optimizer.step()

    def grid(self) -> Tensor:
        return self.volume.data.detach().clone()


def run(loop: Loop, rounds: int, seconds: float = 0.0) -> Run:
    """Steps until the seconds are over; if there are none, both parts of the tutorial's loop."""
    found = Run([0.0], [loop.grid()])
    while found.seconds[-1] < seconds if seconds else len(found.grids) <= 2 * rounds:
        start = time.perf_counter()
        loop.step(len(found.grids) - 1, found.seconds[-1] / seconds if seconds else 0.0)
        found.seconds.append(found.seconds[-1] + time.perf_counter() - start)
        found.grids.append(loop.grid())
    return found
