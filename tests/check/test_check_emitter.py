"""A light that sends what it says agrees; those that do not are found out by the check that is for it."""

import math
from contextlib import contextmanager

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.scenes.lights import EMITTERS
from torch_radbp.emitter.area import Area, AreaKind
from torch_radbp.emitter.constant import Constant, ConstantKind
from torch_radbp.plugin import REGISTRY, register
from torch_radbp.sampling.warp import UNIFORM_SPHERE_PDF
from torch_radbp.tensors.vec import Vec3

QUICK = {"samples": 10_000}
LIGHTS = {name: scene["lamp"].get("emitter", scene["lamp"]) for name, scene in EMITTERS.items() if name != "all"}


@pytest.mark.parametrize("samples", deep_but([10_000], [10_000, 50_000]))
@pytest.mark.parametrize("name", LIGHTS)
def test_every_light_agrees(name, samples):
    result = rb.check_emitter(LIGHTS[name], samples=samples)
    assert result.agrees, str(result)
    assert [finding.check for finding in result.findings] == ["samples", "weights", "light", "finite"]


def test_every_emitter_of_the_package_is_among_them():
    own = {name for name, plugin in REGISTRY["emitter"].items() if plugin.__module__.startswith("torch_radbp.")}
    missing = own - {light["type"] for light in LIGHTS.values()}
    assert not missing, f"the emitters {missing} have no row: add some to EMITTERS in tests/scenes/lights.py"


class Glow(ConstantKind):
    """The same from everywhere."""


class Panel(AreaKind):
    """On a surface."""


@contextmanager
def light(base, kind):
    """The description of a registered light of another kind."""
    register("emitter", "glow")(type("Glow", (base,), {"kind": lambda self: kind(), "__init__": base.__init__}))
    try:
        yield {"type": "glow"}
    finally:
        del REGISTRY["emitter"]["glow"]


def aiming(kind, change):
    """A kind whose aims are changed."""
    return type(kind.__name__, (kind,), {"aim": lambda self, table, proposal, p, pick: change(
        super(kind, self).aim(table, proposal, p, pick))})


def upper(d: Vec3) -> Vec3:
    return Vec3(d.x, d.y, d.z.abs())


BROKEN = {
    "half of the density": (Constant, aiming(Glow, lambda aim: aim._replace(pdf=aim.pdf * 0.5)), {"weights", "light"}),
    "half of every density": (Constant, type("Half", (aiming(Glow, lambda aim: aim._replace(pdf=aim.pdf * 0.5)),), {
        "weighing": lambda self, proposal, d: torch.full_like(d.x, UNIFORM_SPHERE_PDF / 2)}), {"light"}),
    "half of the sphere": (Constant, aiming(Glow, lambda aim: aim._replace(d=upper(aim.d))), {"light"}),
    "directions that are too long": (Constant, aiming(Glow, lambda aim: aim._replace(d=aim.d * 1.01)), {"samples"}),
    "another radiance for rays": (Constant, type("Two", (Glow,), {
        "aim": lambda self, table, proposal, p, pick: (
            lambda aim: aim._replace(radiance=aim.radiance * 1.3))(Glow.aim(self, table, proposal, p, pick))}), {"light"}),
    "other weights": (Constant, type("Weighed", (Glow,), {
        "weighing": lambda self, proposal, d: torch.full_like(d.x, 1 / math.pi)}), {"weights", "light"}),
    "a derivative that is none": (Constant, aiming(Glow, lambda aim: aim._replace(
        radiance=aim.radiance * (1 + (aim.radiance.x * 0).sqrt()))), {"finite"}),
    "a part of the density of a lamp": (Area, aiming(Panel, lambda aim: aim._replace(pdf=aim.pdf * 0.7)),
                                        {"weights", "light"}),
    "a lamp that aims beside itself": (Area, aiming(Panel, lambda aim: aim._replace(
        d=Vec3(aim.d.y, aim.d.x, aim.d.z))), {"samples", "weights", "light"}),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_wrong_is_found(name):
    base, kind, expected = BROKEN[name]
    with light(base, kind) as description:
        result = rb.check_emitter(description, **QUICK)
    assert set(result.failed) == expected, str(result)


def test_a_light_whose_radiance_is_a_module_is_checked_with_another_in_its_place():
    area = Area(radiance=torch.nn.Linear(2, 3))
    assert rb.check_emitter(area, **QUICK).agrees and not area.radiance.tabulated


@pytest.mark.hostile
def test_what_is_no_light_is_named():
    with pytest.raises(TypeError, match="emitter must be a light or a dict that describes one, got a int"):
        rb.check_emitter(3)
