"""Queues of no lane, of one and of a few: renderings of some pixels, compiled and eager, against plain autograd."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

import pytest
import torch

import torch_radbp as rb
from tests.gradients import cotangent, relative_error, unwarned_renderer
from tests.scenes import SKY, diffuse, load, parameters, rectangle, rgb, sensor
from tests.scenes.networks import mlp, textured
from torch_radbp.io.values.transform import rotate, scale, translate

pytestmark = [pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning"),
              pytest.mark.filterwarnings("error:.*runs eagerly:RuntimeWarning")]

TOLERANCE = 1e-10  # as of the strategies in `tests.adjoint.test_oracle`
STRATEGIES = (rb.MemoizedAdjoint(), rb.MemoizedAdjoint(2, keep_hits=False), rb.MemoizedAdjoint("log"), rb.QuadraticAdjoint(),
              rb.ReplayAdjoint())
POSES = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y")

METAL = {"type": "roughconductor", "alpha": 0.3, "eta": 0.9, "k": 2.4, "specular_reflectance": 0.8}
CHALK = rectangle((-1.74, 0, 0), 2.0, bsdf=diffuse(0.3, 0.5, 0.7))  # the left of the view and the middle
PLATE = rectangle((1.74, 0, -0.3), 2.0, (0, 1, 0), -10, bsdf=METAL)  # the right
PAINTING = rectangle((-1.0, 0, 0.1), 0.4, bsdf=textured(mlp(2, 3)))  # before the left
LAMP = rectangle((0.3, 0.2, 5), 2.0, (0, 1, 0), 180, bsdf=diffuse(0.3, 0.2, 0.4),
                 emitter={"type": "area", "radiance": rgb(3, 2, 4)})  # behind the camera, shines forwards


def strip(width: int, **attributes: Any) -> dict[str, Any]:
    """A camera of one row of pixels."""
    film = {"type": "hdrfilm", "width": width, "height": 1, "rfilter": {"type": "box"}}
    return sensor(film=film, **attributes)


UPWARDS = {"origin": (0, 4, 3.5), "target": (0.2, 9, 3)}  # what a camera looks at that sees nothing
AT_LAMP = {"target": (0.3, 0.2, 5)}


class Situation(NamedTuple):
    """A scene in few pixels, and what happens there."""

    objects: dict[str, Any]
    first: tuple[tuple[str, int], ...]  # kind and number of lanes of each queue of the first bounce
    silent: tuple[str, ...]  # beginnings of the names of the parameters without derivative
    bounces: int | None = None  # None: several
    settings: dict[str, Any] = {}
    seed: int = 4


OPEN = {"chalk": CHALK, "plate": PLATE, "lamp": LAMP}
ROOM = OPEN | {"dome": {"type": "sphere", "flip_normals": True, "bsdf": diffuse(0.5, 0.4, 0.6),
                        "to_world": translate((0.7, 0.2, -1)) @ rotate((0.2, 1, 0.1), 20) @ scale((12, 12, 12))}}
NOTHING, DIFFUSE, ROUGH = "nothing", "DiffuseKind", "RoughConductorKind"
SITUATIONS = {
    "one lane of one appearance": Situation(
        {"eye": strip(1), **{name: shape for name, shape in ROOM.items() if name != "plate"}}, ((DIFFUSE, 1),), ()),
    "one lane of two appearances": Situation({"eye": strip(1), **ROOM}, ((DIFFUSE, 1),), ("plate",)),
    "one lane in each of two queues": Situation({"eye": strip(2), **ROOM}, ((DIFFUSE, 1), (ROUGH, 1)), ()),
    "a few lanes": Situation({"eye": strip(5), **ROOM}, ((DIFFUSE, 3), (ROUGH, 2)), ()),
    "a network on one lane": Situation({"eye": strip(4), "painting": PAINTING, **ROOM},
                                       ((DIFFUSE, 1), (DIFFUSE, 2), (ROUGH, 1)), ()),
    "an appearance that no lane meets": Situation(
        {"eye": strip(3), **ROOM, "hidden": rectangle((0, 0, -9), bsdf=textured(mlp(2, 3))),
         "spare": {"type": "dielectric"}}, ((DIFFUSE, 2), (ROUGH, 1)), ("hidden", "spare")),
    "nothing is met": Situation({"eye": strip(3, **UPWARDS), **OPEN}, ((NOTHING, 0),), ("",), 1),
    "nothing is met and there is one appearance": Situation(
        {"eye": strip(3, **UPWARDS), "chalk": CHALK, "lamp": LAMP}, ((NOTHING, 0),), ("",), 1),
    "only the sky is met": Situation({"eye": strip(3, **UPWARDS), **OPEN, "sky": SKY}, ((NOTHING, 3),),
                                     ("eye", "chalk", "plate", "lamp"), 1),
    "only a lamp is met": Situation({"eye": strip(3, **AT_LAMP), **ROOM}, ((DIFFUSE, 3),), ("chalk",), seed=9),
    "only a lamp is met and nothing is scattered": Situation(
        {"eye": strip(3, **AT_LAMP), **ROOM}, ((NOTHING, 3),), ("eye", "chalk", "plate", "lamp.to_world", "lamp.bsdf",
                                                                "dome"), 1,
        {"max_depth": 1}),
    "all lanes die at the first bounce": Situation(
        {"eye": strip(3, origin=(0, 0, -3.5)), **OPEN, "sky": SKY}, ((DIFFUSE, 1), (ROUGH, 2)), ("",), 1),
    "some lanes die at the first bounce": Situation(
        {"eye": strip(5), **ROOM, "chalk": rectangle((-1.74, 0, 0), 2.0, (0, 1, 0), 180, bsdf=diffuse(0.3, 0.5, 0.7))},
        ((DIFFUSE, 3), (ROUGH, 2)), ("chalk",), seed=9),
    "attached, one lane in each of two queues": Situation(
        {"eye": strip(2), **ROOM}, ((DIFFUSE, 1), (ROUGH, 1)), (), None, {"sampling": "attached"}),
    "attached, an appearance that no lane meets": Situation(
        {"eye": strip(3), **ROOM, "hidden": rectangle((0, 0, -9), bsdf=textured(mlp(2, 3)))}, ((DIFFUSE, 2), (ROUGH, 1)),
        ("hidden",), None, {"sampling": "attached"}),
    "roulette from the first bounce": Situation({"eye": strip(5), **ROOM}, ((DIFFUSE, 12), (ROUGH, 8)), ("lamp.bsdf",),
                                                None, {"rr_depth": 1, "spp": 4}),
}


@pytest.fixture
def met(monkeypatch) -> list[tuple[tuple[str, int], ...]]:
    """Kind and number of lanes of the queues of every bounce for which rays are cast."""
    found, wavefront = [], import_module("torch_radbp.path.wavefront")
    queued = wavefront.queued

    def watched(integrand, *arguments):
        result = queued(integrand, *arguments)
        looks = [(integrand.scatterer(queue.event), queue.last - queue.first) for queue in result[-1]]
        found.append(tuple((NOTHING if look is None else type(look.kind).__name__, lanes) for look, lanes in looks))
        return result

    monkeypatch.setattr(wavefront, "queued", watched)
    return found


def image_and_gradients(renderer: rb.Renderer, wanted: list[torch.Tensor],
                        seed: int = 4) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """An image, and the gradients of some parameters."""
    image = renderer(seed=seed)
    gradients = torch.autograd.grad(image, wanted, cotangent(image.detach()), materialize_grads=True)
    return image.detach(), list(gradients)


STILL = ("a network on one lane", "nothing is met")


@pytest.mark.parametrize("name, poses", [
    pytest.param(name, poses, id=f"{name}-{'poses' if poses else 'colours'}",
                 marks=[] if poses or name in STILL else pytest.mark.deep)  # what moves has colours, too
    for name in SITUATIONS for poses in (False, True)])
def test_image_and_gradients_are_those_of_the_tape_where(name, poses, met):
    objects, first, silent, bounces, settings, seed = SITUATIONS[name]
    scene = load(**objects)
    names = [name for name, _ in scene.named_parameters() if poses or not name.endswith(POSES)]
    wanted = parameters(scene, names)
    renderer = unwarned_renderer(scene, terms=["interior"], share_samples=True,
                                 **{"spp": 1, "max_depth": 4, "rr_depth": 3, "adjoint": rb.TapeAdjoint()} | settings)
    expected, tape = image_and_gradients(renderer, wanted, seed)
    assert met[0] == first
    assert len(met) == bounces if bounces else len(met) > 1
    assert torch.isfinite(expected).all() and (expected.max() > 0) == ("" not in silent)
    for name, gradient in zip(names, tape):
        assert torch.isfinite(gradient).all() and (gradient.abs().max() > 0) != name.startswith(silent), name
    for compiled, adjoint in [(False, rb.MemoizedAdjoint()), *((True, adjoint) for adjoint in STRATEGIES)]:
        renderer.compile_stages, renderer.adjoint = compiled, adjoint
        image, gradients = image_and_gradients(renderer, wanted, seed)
        assert torch.allclose(image, expected, rtol=TOLERANCE, atol=0)
        for name, gradient, reference in zip(names, gradients, tape):
            if name.startswith(silent):
                assert torch.equal(gradient, torch.zeros_like(gradient)), (name, adjoint, compiled)
            else:
                assert relative_error(gradient, reference) < TOLERANCE, (name, adjoint, compiled)
