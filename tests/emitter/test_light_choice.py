"""Lights picked by a tree: with the probabilities that are stated, of the light that there is, and with less noise."""

import numpy as np
import pytest
import torch
from scipy.stats import chi2

import torch_radbp as rb
from tests.emitter.lanes import light_numbers, mean_and_error, on_the_floor
from tests.gradients import relative_error
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from tests.scenes.lights import EMITTERS, FLOOR, turned
from torch_radbp.connection.light import sample_light
from torch_radbp.io.values.transform import scale, translate
from torch_radbp.scene.packing.pack import pack
from torch_radbp.scene.tables.light_choice import MANY, LightPick, chance_of_emitter, drawn_element
from torch_radbp.scene.tables.light_tree import Vantage, halved, importance
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.vec import Vec3
from torch_radbp.vertex.emission import vantage

COUNT = 100_000
GROUPS = {"area": ("area",), "point": ("point",),
          "mixed": ("area", "area_sphere", "point", "spot", "spot_image", "projector"),
          "mixed with what is far": ("area", "point", "spot", "envmap", "directional", "directionalarea")}


def moved(emitter: dict, number: int) -> dict:
    """An emitter at another place and of another brightness."""
    place = 0.9 * (number % 5) - 1.8, 0.2 * (number % 3), 0.8 * (number // 5) - 1.6
    at = translate(place) @ turned(7 * number, 0, 5 * number)
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
    tensors = with_choice(scene, "tree")
    si = on_the_floor(scene, tensors, count, 1).si
    numbers = light_numbers(count, 2)
    element, pmf = drawn_element(tensors.lights.choice, vantage(si), numbers)
    return tensors, si, numbers, LightPick(element, pmf, torch.zeros_like(pmf))


def with_choice(scene: rb.Scene, light_choice: str):
    """The tensors of a scene, detached."""
    tensors = pack(scene, light_choice=light_choice)
    return with_leaves(tensors, [leaf.detach() if isinstance(leaf, torch.Tensor) else leaf for leaf in leaves_of(tensors)])


@pytest.mark.parametrize("group", GROUPS)
def test_probabilities_add_up_and_are_those_of_the_draws(group):
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
    element, pmf = drawn_element(choice, seen, light_numbers(COUNT, 5))
    # Where the bounds of a node promise light, and those of both children do not, nothing is picked.
    found = pmf > 0
    lost = 1 - float(expected.sum())
    assert -1e-12 < lost < 0.1 and abs(float((~found).double().mean()) - lost) < 4 * (lost / COUNT) ** 0.5 + 1e-12
    assert relative_error(pmf[found], expected[element.long()][found]) < 1e-12
    counts = torch.bincount(element.long()[found], minlength=len(elements)).double()
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
            tensors, picked = with_choice(scene, "uniform"), None
            si, numbers = on_the_floor(scene, tensors, COUNT, 1).si, light_numbers(COUNT, 3)
        light = sample_light(tensors, tensors, si.p, numbers, picked)
        cosine = si.frame.to_local(light.d).z
        usable = (light.pdf > 0) & (cosine > 0)
        found[way] = mean_and_error((light.radiance * (cosine * usable / light.pdf.clamp_min(1e-30))).stack())
    (mean, error), (other, other_error) = found["tree"], found["uniform"]
    assert (other > 0).all()
    # Three channels, four scenes: beyond 4.5 by chance in one run of 10,000; the seeds are fixed.
    assert ((mean - other).abs() / torch.hypot(error, other_error)).max() < 4.5
    assert (error < other_error).all()


def test_lights_are_halved_by_place_into_leaves_of_their_own():
    for count in (1, 2, 3, 7, 20, 1000):
        places = torch.rand(count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(count))
        leaf, depth = halved(places)
        assert depth == (count - 1).bit_length() and len(leaf.unique()) == count and leaf.max() < 1 << depth
        sizes = torch.bincount(leaf >> 1, minlength=max(1, (1 << depth) // 2))
        assert sizes.max() <= 2 and (count < 2 or sizes.min() >= 1)
        if count == 1000:  # neighbours among the leaves are neighbours in space
            order = places[leaf.argsort()]
            near = (order[1:] - order[:-1]).norm(dim=1).mean()
            assert near < 0.25 * (places[1:] - places[:-1]).norm(dim=1).mean()


def test_a_node_promises_light_wherever_one_of_its_lights_sends_any():
    scene = many(GROUPS["mixed"], 40)
    tensors, si, _, _ = picks(scene, 2000)
    tree, seen = tensors.lights.choice.tree, vantage(si)
    values = [importance(with_leaves(tree.nodes, [leaf[node] for leaf in leaves_of(tree.nodes)]), seen)
              for node in range((2 << tree.depth) - 2)]
    for level in range(2, tree.depth + 1):
        children = range((1 << level) - 2, (2 << level) - 2)
        for child in children:
            parent = (child - ((1 << level) - 2)) // 2 + (1 << (level - 1)) - 2
            assert not ((values[child] > 1e-9 * values[child].max()) & (values[parent] == 0)).any()


def test_few_lamps_are_picked_as_before_and_many_by_the_tree():
    for count in (1, MANY - 1, MANY):
        tensors = pack(many(GROUPS["point"], count))
        assert tensors.lights.by_place == (count >= MANY)
        assert pack(many(GROUPS["point"], count), light_choice="tree").lights.by_place
        assert not pack(many(GROUPS["point"], count), light_choice="uniform").lights.by_place
    sky = {"type": "constant", "radiance": rgb(1, 1, 1)}
    assert not pack(load(sensor=sensor(4), sky=sky, **FLOOR), light_choice="tree").lights.by_place  # none has a place


def test_sampling_weights_hold_in_the_tree():
    lamps = {f"lamp_{k}": rectangle((0.1 * k, 1, 0), 0.05, angle=90, bsdf=diffuse(0.1, 0.1, 0.1), emitter={
        "type": "area", "radiance": rgb(1, 1, 1), "sampling_weight": weight}) for k, weight in enumerate((1.0, 0.0, 2.0))}
    scene = load(sensor=sensor(4), **FLOOR, **lamps)
    tensors, si, _, picked = picks(scene, 20_000)
    counts = torch.bincount(picked.element // 2, minlength=3)
    assert counts[1] == 0 and 1.7 < float(counts[2] / counts[0]) < 2.3
    chance = chance_of_emitter(tensors.lights.choice, vantage(si), torch.full_like(picked.element, 2))
    assert (chance == 0).all()


def test_dark_lamps_are_picked_for_their_derivatives():
    lamps = {f"lamp_{k}": {"type": "point", "position": [0.4 * k - 1, 1, 0], "intensity": 0.0} for k in range(10)}
    scene = load(sensor=sensor(8), **FLOOR, **lamps)
    intensity = scene.get_parameter("lamp_3.intensity.value").requires_grad_()
    gradient, = torch.autograd.grad(rb.render(scene, spp=16, max_depth=2).mean(), intensity)
    assert gradient > 0


def test_the_scale_of_a_scene_changes_no_probability():
    for factor in (1e-4, 1.0, 1e4):
        whole, ball = scale((factor,) * 3), scale((0.1,) * 3)
        lamps = {f"lamp_{k}": {"type": "sphere", "to_world": whole @ translate((0.4 * k - 1, 1, 0.1 * k)) @ ball,
                               "emitter": {"type": "area"}} for k in range(9)}
        scene = load(torch.float32, sensor=sensor(4), floor=rectangle((0, 0, 0), factor, angle=-90), **lamps)
        choice = with_choice(scene, "tree").lights.choice
        like = torch.zeros(9)
        seen = Vantage(Vec3(like + 0.3 * factor, like, like), Vec3(like, like + 1, like))
        first = torch.tensor([int((choice.cumulative < k).sum()) for k in range(9)], dtype=torch.int32) + 1
        chance = chance_of_emitter(choice, seen, first)
        if factor == 1e-4:
            expected = chance
        assert abs(float(chance.sum()) - 1) < 1e-5 and relative_error(chance, expected) < 1e-4


def test_a_wrong_choice_lists_those_there_are():
    with pytest.raises(ValueError, match="light_choice='power'.*tree, uniform"):
        rb.Renderer(many(GROUPS["point"], 2), light_choice="power")


def test_images_agree_with_those_of_a_uniform_choice():
    """With lamps that BSDF sampling finds often, so that both halves of multiple importance sampling count."""
    lamps = {f"lamp_{k}": rectangle((0.5 * (k % 3) - 0.5, 0.6, 0.5 * (k // 3) - 0.5), 0.1 + 0.01 * k, angle=90, emitter={
        "type": "area", "radiance": rgb(1 + k, 2, 3)}) for k in range(9)}
    scene = load(sensor=sensor(8, (0, 0.5, 3.5), (0, 0, 0), 45), **FLOOR, **lamps, sky={"type": "constant", "radiance": 0.2})
    images = {}
    for way in ("uniform", "tree"):
        renderer = rb.Renderer(scene, light_choice=way, max_depth=4, spp=64, compile=False)
        with torch.no_grad():
            images[way] = torch.stack([renderer(seed=seed).mean() for seed in range(12)])
    (mean, error), (other, other_error) = map(mean_and_error, images.values())
    assert error < 0.01 * mean and abs(mean - other) < 4 * torch.hypot(error, other_error)
