"""Lights picked by a tree: with the probabilities that are stated, of the light that there is, and with less noise."""

import numpy as np
import pytest
import torch
from scipy.stats import chi2

import torch_radbp as rb
from tests.derivatives.scenes import SCENES
from tests.emitter.lights import EMITTERS, FLOOR, detached, light_numbers, mean_and_error, on_the_floor, turned
from tests.gradients import image_and_gradients, relative_error
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from torch_radbp.io.transform import scale, translate
from torch_radbp.record import leaves_of, with_leaves
from torch_radbp.sampling.mis import power_heuristic
from torch_radbp.sampling.warp import cosine_hemisphere_pdf
from torch_radbp.scene.light import sample_light, vantage
from torch_radbp.scene.light_choice import MANY, LightPick, chance_of_emitter, drawn_element
from torch_radbp.scene.light_tree import Vantage, halved, importance
from torch_radbp.scene.pack import pack
from torch_radbp.vec import Vec3

COUNT = 100_000
GROUPS = {"area": ("area",), "point": ("point",), "mixed": ("area", "area_sphere", "point", "spot", "spot_image", "projector"),
          "mixed with what is far": ("area", "point", "spot", "envmap", "directional", "directionalarea")}


def moved(emitter: dict, number: int) -> dict:
    """An emitter at another place and of another brightness."""
    at = translate((0.9 * (number % 5) - 1.8, 0.2 * (number % 3), 0.8 * (number // 5) - 1.6)) @ turned(7 * number, 0, 5 * number)
    found = {**emitter}
    if "position" in found:
        found["position"] = (at @ [*found["position"], 1])[:3].tolist()
    elif "direction" not in found:
        found["to_world"] = at @ found.get("to_world", np.eye(4))
    return found


def many(names: tuple[str, ...], count: int = 20, dtype: torch.dtype = torch.float64, **more) -> rb.Scene:
    """A floor under `count` lamps of some kinds, one of each kind that can be there only once."""
    found = {}
    for number in range(count):
        name = names[number % len(names)]
        if name in ("envmap", "constant") and number >= len(names):
            name = names[0]
        found[f"lamp_{number}"] = moved(EMITTERS[name]["lamp"], number)
    return load(dtype, sensor=sensor(8, (0, 0.5, 3.5), (0, 0, 0), 45), **FLOOR, **found, **more)


def picks(scene: rb.Scene, count: int = COUNT):
    """Surface points on the floor, and the elements picked there."""
    tensors = with_tree(scene)
    si = on_the_floor(scene, tensors, count, 1).si
    numbers = light_numbers(count, 2)
    element, pmf = drawn_element(tensors.lights.choice, vantage(si), numbers)
    return tensors, si, numbers, LightPick(element, pmf, torch.zeros_like(pmf))


def with_tree(scene: rb.Scene):
    tensors = pack(scene, light_choice="tree")
    return with_leaves(tensors, [leaf.detach() if isinstance(leaf, torch.Tensor) else leaf for leaf in leaves_of(tensors)])


@pytest.mark.parametrize("group", GROUPS)
def test_probabilities_add_up_to_one_and_are_those_of_the_draws(group):
    tensors, si, _, picked = picks(many(GROUPS[group]))
    lights, choice = tensors.lights, tensors.lights.choice
    one = Vantage(*(Vec3(*(c[:1] for c in v)) for v in vantage(si)))
    seen = Vantage(*(v.map(lambda c: c.expand(COUNT)) for v in one))
    elements = torch.arange(len(choice.pmf), dtype=torch.int32)
    kinds = tensors.layout.lights
    bounded = torch.tensor([kinds[k].bounded for k in lights.kind.tolist()])
    places = Vantage(*(v.map(lambda c: c.expand(len(elements))) for v in one))
    expected = torch.where(bounded, chance_of_emitter(choice, places, elements) * choice.pmf, 0.0)
    if choice.beside is not None:
        for number, emitter in enumerate(choice.beside.emitter.tolist()):
            own = (torch.floor(choice.cumulative - 1e-9) == emitter) & ~bounded
            expected += own * choice.beside.share * choice.beside.pmf[number] * choice.pmf
    assert abs(float(expected.sum()) - 1) < 1e-12
    element, pmf = drawn_element(choice, seen, light_numbers(COUNT, 5))
    assert relative_error(pmf, expected[element.long()]) < 1e-12
    counts = torch.bincount(element.long(), minlength=len(elements)).double()
    likely = expected * COUNT > 5
    statistic = float(((counts - expected * COUNT) ** 2 / (expected * COUNT))[likely].sum())
    assert likely.sum() > 5 and statistic < chi2.ppf(1 - 1e-4, int(likely.sum()))
    assert not counts[expected == 0].any()


@pytest.mark.parametrize("group", GROUPS)
def test_the_light_is_that_of_a_uniform_choice_and_less_noisy(group):
    scene = many(GROUPS[group])
    found = {}
    for way in ("uniform", "tree"):
        if way == "tree":
            tensors, si, numbers, picked = picks(scene)
        else:
            tensors, picked = detached(load_uniform(scene)), None
            si, numbers = on_the_floor(scene, tensors, COUNT, 1).si, light_numbers(COUNT, 3)
        light = sample_light(tensors, tensors, si, numbers, picked)
        cosine = si.frame.to_local(light.d).z
        usable = (light.pdf > 0) & (cosine > 0)
        found[way] = mean_and_error((light.radiance * (cosine * usable / light.pdf.clamp_min(1e-30))).stack())
    (mean, error), (other, other_error) = found["tree"], found["uniform"]
    assert (other > 0).all()
    # Three channels, four scenes: beyond 4.5 by chance in one run of 10,000; the seeds are fixed.
    assert ((mean - other).abs() / torch.hypot(error, other_error)).max() < 4.5
    assert (error < other_error).all()
