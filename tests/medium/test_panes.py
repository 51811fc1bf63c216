"""Panes of glass and masks in scenes with media: light passes them straight, which is no bounce.

Against `null` and the opaque material where a mask is open or closed; in closed form; next-event estimation against chance;
the gradient of every strategy, stride and way of running against the tape's; forward mode; differences.
"""

from __future__ import annotations

import math
import warnings
from itertools import product

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import FEW, MOVED, SOME, assert_informative, assert_transposed, image_and_gradients, relative_error
from tests.medium.compared import Move, compared
from tests.rendering.taped import assert_recorded_alike
from tests.scenes import diffuse, load, overhead, rectangle, rgb
from tests.scenes.media import (
    BLACK,
    DULL,
    MOVING,
    NAMES,
    NULL,
    SETTINGS,
    assert_chance_and_connection_agree,
    ball,
    haze,
    room,
    slab,
)
from torch_radbp.io.values.transform import scale

CLAY = diffuse(0.7, 0.5, 0.3)
ROUGH = {"type": "roughdielectric", "int_ior": 1.3, "alpha": 0.3}
AIR = {"type": "ref", "id": "air"}
GLOW = (0.9, 0.6, 0.3)  # radiance per length
TINT = (0.9, 0.8, 0.7)
COLOUR = torch.tensor(TINT, dtype=torch.float64)
SMOOTH = torch.rand(4, 4, 1, generator=torch.Generator().manual_seed(0)).numpy()  # opacities


def thin(tint=TINT) -> dict:
    return {"type": "thindielectric", "int_ior": 1.5, "specular_transmittance": rgb(*tint)}


def passing(cosine: torch.Tensor | float) -> torch.Tensor:
    """What a pane of `thin`, not tinted, lets pass; `ext_ior` is that of air."""
    cosine, eta = torch.as_tensor(cosine, dtype=torch.float64), 1.5 / 1.000277
    inside = (1 - (1 - cosine**2) / eta**2).sqrt()
    across, parallel = (cosine - eta * inside) / (cosine + eta * inside), (eta * cosine - inside) / (eta * cosine + inside)
    reflectance = (across**2 + parallel**2) / 2
    return 1 - 2 * reflectance / (1 + reflectance)


def mask(opacity=0.4, bsdf=CLAY) -> dict:
    return {"type": "mask", "opacity": opacity, "nested_bsdf": bsdf}


def turned(bsdf: dict) -> dict:
    """With a normal that leans to one side."""
    return {"type": "normalmap", "normalmap": [0.6, 0.45, 0.9], "nested_bsdf": bsdf}


PANES = {"thin": thin(), "mask": mask(), "bitmap": mask({"type": "bitmap", "bitmap": SMOOTH, "raw": True}),
         "mask of thin": mask(0.5, thin()), "blend": {"type": "blendbsdf", "weight": 0.4, "clay": CLAY, "hole": NULL},
         "turned mask": turned(mask())}
PARAMETERS = {"thin": ["eta", "specular_transmittance.value", "specular_reflectance.value"],
              "mask": ["opacity.value", "nested_bsdf.reflectance.value"], "bitmap": ["opacity.data"],
              "mask of thin": ["opacity.value", "nested_bsdf.eta"], "blend": ["weight.value"],
              "turned mask": ["nested_bsdf.opacity.value", "normalmap.value"]}


def before_a_lamp(bsdf: dict, core: dict = NULL, **more) -> rb.Scene:
    """Two balls of haze, one in the other, before a floor that sends light."""
    return load(torch.float64, camera=overhead(2, 4.0, 0.7), **more,
                floor=rectangle((0, 0, 0), 1.5, bsdf=diffuse(0.5, 0.5, 0.5), emitter={"type": "area", "radiance": 0.3}),
                ball=ball(0.9, bsdf=bsdf, interior=haze((0.6, 0.8, 1.0), (0.5, 0.4, 0.3), 0.4)),
                core=ball(0.6, bsdf=core, interior=haze((1, 2, 1.5), (0.3, 0.6, 0.5), -0.3)),
                sky={"type": "constant", "radiance": rgb(0.2, 0.3, 0.4)})


def under_a_pane(bsdf: dict, **more) -> rb.Scene:
    """A pane in haze that fills all space, above a floor that sends light."""
    return load(torch.float64, air=DULL, camera=overhead(2, 4.0, 0.7) | {"medium": AIR},
                floor=rectangle((0, 0, 0), 1.5, bsdf=diffuse(0.5, 0.5, 0.5), emitter={"type": "area", "radiance": 0.3}),
                pane=rectangle((0, 0, 1.0), 3.0, bsdf=bsdf), **more)


def colours(*images: torch.Tensor) -> torch.Tensor:
    """(N, 3) of all pixels, which are independent."""
    return torch.cat([image[0].flatten(1).T for image in images])


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
@pytest.mark.parametrize("opacity, same", [(0.0, NULL), (1.0, CLAY)], ids=["open", "closed"])
def test_a_mask_without_holes_or_without_the_rest_is_the_material_or_null(opacity, same, compile):
    images = [rb.render(room(bsdf), compile=compile, seed=2, **SETTINGS) for bsdf in (mask(opacity), same)]
    assert images[0].mean() > 0.1 and relative_error(*images) < 1e-12


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_light_through_panes_is_left_by_glass_and_medium(compile):
    """A slab that only absorbs between two panes, before a floor that sends light; one bounce: passing counts nothing."""
    scene = load(torch.float64, camera=overhead(4, 4.0, 1e-4),
                 slab=slab(2, 1.5, interior=haze((0.2, 0.4, 0.8), (0, 0, 0))) | {"bsdf": thin()},
                 floor=rectangle((0, 0, 0), 3.0, bsdf=BLACK, emitter={"type": "area", "radiance": 1.0}))
    pixels = colours(*(rb.render(scene, spp=4095, max_depth=1, compile=compile, seed=seed) for seed in range(3)))
    wanted = (passing(1.0) * COLOUR)**2 * torch.exp(-1.5 * torch.tensor([0.2, 0.4, 0.8], dtype=torch.float64))
    error = pixels.std(0) / math.sqrt(len(pixels))
    assert ((pixels.mean(0) - wanted).abs() < 4 * error).all() and (error < 0.005 * wanted).all()


GLOWS_BEHIND = {"thin": (thin(), passing(1.0) * COLOUR), "mask": (mask(0.4, BLACK), 0.6),
                "mask of thin": (mask(0.4, thin()), 0.6 + 0.4 * passing(1.0) * COLOUR)}  # what of it they let pass


@pytest.mark.parametrize("depth, name", [case if case[1] == "mask of thin" else deep(*case)
                                         for case in product((1, 3), GLOWS_BEHIND)])
def test_a_medium_that_glows_behind_a_pane_is_seen_through_it(depth, name):
    """t e (1 - exp(-sigma l)) / sigma, with t of the pane; and its derivative by e. At depth 1 flights are the last."""
    pane, share = GLOWS_BEHIND[name]
    sigma, emission = torch.tensor((0.7, 0.35, 1.4), dtype=torch.float64), torch.tensor((0.5, 1, 2), dtype=torch.float64)
    glow = haze(tuple(sigma.tolist()), (0, 0, 0)) | {"emission": rgb(*emission.tolist())}
    scene = load(torch.float64, camera=overhead(4, 4.0, 1e-4), slab=slab(1, 1.5, interior=glow),
                 pane=rectangle((0, 0, 3), 3.0, bsdf=pane))
    wanted, settings = share * emission * (1 - torch.exp(-1.5 * sigma)) / sigma, {"spp": 4095, "max_depth": depth, "seed": 1}
    changed = rb.jvp(scene, {"slab.interior.emission.value.value": torch.ones(3, dtype=torch.float64)}, **settings)
    for found, right in ((rb.render(scene, **settings), wanted), (changed, wanted / emission)):
        pixels = colours(found)
        error = pixels.std(0) / math.sqrt(len(pixels))
        assert ((pixels.mean(0) - right).abs() < 4 * error + 1e-5 * right).all() and (error < 0.02 * right).all()


def test_connections_to_lights_pass_panes():
    """A floor below a pane and a bulb: as much light as without the pane, times what that lets through, and no noise."""
    bulb = {"type": "point", "position": [0.0, 0.0, 2.0], "intensity": 3.0}
    near = overhead(1, 0.5, 0.01) | {"medium": AIR}  # below the pane
    plain, tinted = (load(torch.float64, air=haze((0.2, 0.4, 0.8), (0, 0, 0)), camera=near, bulb=bulb,
                          floor=rectangle((0, 0, 0), 1.5, bsdf=diffuse(0.5, 0.5, 0.5)),
                          pane=rectangle((0, 0, 1.0), 3.0, bsdf=bsdf)) for bsdf in (NULL, thin()))
    images = [rb.render(scene, spp=4, max_depth=2).mean((0, 2, 3)) for scene in (plain, tinted)]
    assert images[0].min() > 0
    torch.testing.assert_close(images[1] / images[0], passing(1.0) * COLOUR, rtol=1e-4, atol=0)


def below_a_bulb(bsdf: dict, camera: dict) -> rb.Scene:
    """A floor below a pane and a bulb, in a medium that only absorbs."""
    return load(torch.float64, air=haze((0.2, 0.4, 0.8), (0, 0, 0)), camera=camera | {"medium": AIR},
                bulb={"type": "point", "position": [0.0, 0.0, 2.0], "intensity": 3.0},
                floor=rectangle((0, 0, 0), 1.5, bsdf=diffuse(0.5, 0.5, 0.5)), pane=rectangle((0, 0, 1.0), 3.0, bsdf=bsdf))


def test_connections_pass_panes_with_turned_normals():
    """By the shares of their holes; the shadowing factor is 1 for light that comes from straight above."""
    holed, plain, tinted, full = (rb.render(below_a_bulb(bsdf, overhead(1, 0.5, 0.01)), spp=4, max_depth=2, seed=2)
                                  for bsdf in (turned(mask(0.4, BLACK)), NULL, turned(thin((1, 1, 1))), mask(0.0, BLACK)))
    assert plain.min() > 0
    torch.testing.assert_close(holed, 0.6 * plain, rtol=1e-5, atol=0)
    lean = 0.8 / (0.2**2 + 0.1**2 + 0.8**2)**0.5  # the cosine of light to the normal
    torch.testing.assert_close(tinted, passing(lean) * full, rtol=1e-4, atol=0)


def test_paths_from_lamps_and_connections_pass_panes_with_turned_normals_alike():
    scene = below_a_bulb(turned(mask(0.4, BLACK)), overhead(2, 0.5, 1.0))
    means = torch.stack([torch.stack([
        rb.render(scene, spp=4096, max_depth=2, light_paths=light_paths, seed=seed).mean((0, 2, 3)) for seed in range(12)])
        for light_paths in ("camera", "all")])
    difference, error = means.mean(1).diff(dim=0)[0], (means.var(1) / means.shape[1]).sum(0).sqrt()
    assert (means > 0).all() and (difference.abs() < 4 * error).all() and (error < 0.03 * means[0].mean(0)).all()


def test_a_floor_below_a_lamp_behind_a_tinted_pane_is_as_bright_as_the_integral():
    """Over the lamp; connections and chance together. Mitsuba's `volpathmis` is too bright here, its `volpath` right."""
    nothing = haze((0, 0, 0), (0, 0, 0))
    scene = load(torch.float64, air=nothing, camera=overhead(4, 0.5, 0.001) | {"medium": AIR},
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.5, 0.5, 0.5)), pane=rectangle((0, 0, 1), 50.0, bsdf=thin()),
                 lamp=rectangle((0, 0, 2), 1.0, (1, 0, 0), 180, bsdf=BLACK, emitter={"type": "area", "radiance": 1.0}))
    pixels = colours(rb.render(scene, spp=1024, max_depth=2, seed=1))
    x = (torch.arange(400, dtype=torch.float64) + 0.5) / 200 - 1
    cosine = 2.0 * (x.square()[:, None] + x.square() + 4.0).rsqrt()
    solid_angle = cosine**3 / 4.0 / 200**2  # of a piece of the lamp
    shone = (passing(cosine) * cosine * solid_angle).sum() * 0.5 / math.pi * COLOUR
    error = pixels.std(0) / math.sqrt(len(pixels))
    assert ((pixels.mean(0) - shone).abs() < 4 * error).all() and (error < 0.003 * shone).all()


@pytest.mark.parametrize("name", deep_but(["mask"], ["thin", "mask", "mask of thin", "blend", "turned mask"]))
def test_lamps_behind_panes_by_chance_and_by_connection_agree(name):
    assert_chance_and_connection_agree(room(PANES[name]))


def test_a_lamp_that_is_otherwise_invisible_is_seen():
    """By a ray that passes the boundary of a medium that shines: a vertex is there, as on any lamp."""
    scene = load(torch.float64, camera=overhead(2, 4.0, 0.1), floor=rectangle((0, 0, 0), 3.0, bsdf=BLACK),
                 ball=ball(bsdf=NULL, interior=haze(), emitter={"type": "area", "radiance": 0.7}))
    torch.testing.assert_close(rb.render(scene, spp=4, max_depth=1), torch.full((1, 3, 2, 2), 0.7, dtype=torch.float64))


@pytest.mark.parametrize("compile, name, strategies", [
    pytest.param(True, "mask of thin", FEW, id="few"),
    *(deep(*case, SOME, id=f"{case[0]}-{case[1]}") for case in product((False, True), PANES))])
def test_every_strategy_and_stride_gives_the_gradient_of_the_tape(compile, name, strategies):
    names, scene = [*NAMES, *(f"ball.bsdf.{each}" for each in PARAMETERS[name])], room(PANES[name])
    image, expected = image_and_gradients(scene, names, **SETTINGS | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in strategies:
        found, gradients = image_and_gradients(scene, names, compile=compile, **SETTINGS | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for each, gradient, wanted in zip(names, gradients, expected):
            assert relative_error(gradient, wanted) < 1e-10, (adjoint, each)


@pytest.mark.parametrize("compile, name, glow, inner, sampling, strategies", [
    pytest.param(False, "bitmap", GLOW, ROUGH, "hybrid", FEW, id="few"),
    *(deep(*case, MOVED) for case in product((False, True), ("thin", "bitmap"), (None, GLOW), (NULL,),
                                             ("detached", "hybrid", "attached")))])
def test_every_strategy_gives_the_gradient_of_the_tape_of_what_moves(compile, name, glow, inner, sampling, strategies):
    """Around a boundary that is invisible, or one of rough glass."""
    names = [*MOVING, f"ball.bsdf.{PARAMETERS[name][0]}", *(["core.bsdf.alpha.value"] if inner is ROUGH else [])]
    settings = SETTINGS | {"sampling": sampling, "max_depth": 4}
    scene = room(PANES[name], glow, inner)
    image, expected = image_and_gradients(scene, names, **settings | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in strategies:
        found, gradients = image_and_gradients(scene, names, compile=compile, **settings | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for each, gradient, wanted in zip(names, gradients, expected):
            assert (gradient - wanted).abs().max() <= 1e-10 * wanted.abs().max(), (adjoint, each)


@pytest.mark.parametrize("compile", [pytest.param(False, id="eager"), deep(True, id="compiled")])
@pytest.mark.parametrize("name, parameters", [
    ("mask of thin", ("bsdf.opacity.value", "bsdf.nested_bsdf.eta", "bsdf.nested_bsdf.specular_transmittance.value")),
    deep("thin", ("bsdf.eta", "bsdf.specular_transmittance.value")), deep("mask", ("bsdf.opacity.value",)),
    deep("thin", ("to_world",)), ("bitmap", ("to_world",))])
def test_forward_mode_is_the_transpose_of_backward(compile, name, parameters):
    """Where the ball moves, the camera does, too."""
    moves = "to_world" in parameters
    names = [f"ball.{parameter}" for parameter in parameters] + ["camera.to_world"] * moves
    assert_transposed(room(PANES[name]), *names, **SETTINGS | ({"terms": ("interior",)} if moves else {})
                      | {"compile": compile, "max_depth": 3})


@pytest.mark.parametrize("build, name", [
    (lambda: before_a_lamp(thin()), "ball.bsdf.specular_transmittance.value"),
    (lambda: before_a_lamp(thin()), "ball.bsdf.specular_reflectance.value"),
    (lambda: before_a_lamp(mask()), "ball.bsdf.nested_bsdf.reflectance.value"),
    deep(lambda: under_a_pane(thin()), "pane.bsdf.specular_transmittance.value"),
    (lambda: under_a_pane(thin((0, 0, 0)), bulb={"type": "point", "position": [0.3, 0.2, 2.5], "intensity": 3.0}),
     "pane.bsdf.specular_transmittance.value")],
    ids=["tint of a ball", "reflection", "what is not hole", "tint of a pane", "tint of 0"])
def test_derivatives_are_those_of_differences_of_the_same_samples(build, name):
    """By parameters that decide nothing. The image is a polynomial of few degrees in them, of degree 1 or 2 in that of 0."""
    scene, settings = build(), {"spp": 64, "max_depth": 4, "rr_depth": 99, "seed": 1, "share_samples": True}
    parameter, step = scene.get_parameter(name), 1e-3
    tangent = torch.linspace(0.5, 1.0, parameter.numel(), dtype=torch.float64).view_as(parameter)
    at = parameter.detach().clone()
    found, images = rb.jvp(scene, {name: tangent}, **settings), []
    for steps in (0, 1, 2) if at.max() == 0 else (-1, 1):
        with torch.no_grad():
            parameter.copy_(at + steps * step * tangent)
            images.append(rb.render(scene, **settings))
    if len(images) == 3:
        difference = (4 * images[1] - 3 * images[0] - images[2]) / (2 * step)
    else:
        difference = (images[1] - images[0]) / (2 * step)
    assert found.abs().max() > 1e-3 and relative_error(found, difference) < 1e-5


@pytest.mark.parametrize("name, parameter, at", [
    ("thin", "eta", None), deep("mask", "opacity.value", None), ("mask", "opacity.value", 0.0),
    deep("mask", "opacity.value", 1.0), deep("bitmap", "opacity.data", None), deep("mask of thin", "opacity.value", None),
    deep("blend", "weight.value", None)])
def test_derivatives_by_what_decides_are_those_of_differences(name, parameter, at):
    """In a closed ball of clay, before a lamp, there would be more noise."""
    shape, build = ("ball", before_a_lamp) if name == "thin" else ("pane", under_a_pane)
    scene = build(PANES[name])
    if at is not None:
        with torch.no_grad():
            scene.get_parameter(f"{shape}.bsdf.{parameter}").fill_(at)
    spp = 1 << (13 if name == "thin" or at == 0.0 else 15)  # the others have more noise
    found, = compared(scene, [Move(f"{shape}.bsdf.{parameter}", 0.1)], spp=spp, seed=20, max_depth=4)
    found.assert_agrees(0.07, 3.5)


def under_a_smooth_mask(air: dict, half: float) -> rb.Scene:
    """A black mask whose opacity changes smoothly, so that nothing jumps but at its edges; the floor sends light, or else
    the air on both sides."""
    tiles = scale((half / 3, half / 3, 1))
    smooth = {"type": "bitmap", "bitmap": SMOOTH, "raw": True, "wrap_mode": "mirror", "to_uv": tiles}
    return load(torch.float64, air=air, camera=overhead(2, 4.0, 0.7) | {"medium": AIR},
                floor=rectangle((0, 0, 0), 30.0, bsdf=BLACK,
                                emitter={"type": "area", "radiance": 0.0 if "emission" in air else 1.0}),
                pane=rectangle((0, 0, 1.0), half, bsdf=mask(smooth, BLACK))).requires_grad_(False)


SHIFT, SIZE, HEIGHT = (0, 3), (0, 0), (2, 3)  # entries of a pose
DIM = haze((0.3, 0.4, 0.5), (0, 0, 0))


@pytest.mark.parametrize("air, half, spp, moved", [
    (DIM, 3.0, 1 << 16, [("pane.to_world", SHIFT, 0.02)]),
    deep(DIM, 3.0, 1 << 17, [("pane.to_world", SHIFT, 0.02), ("camera.to_world", SHIFT, 0.02)]),
    deep(DIM, 3.0, 1 << 18, [("pane.to_world", SIZE, 0.06)]),
    deep(DULL, 30.0, 3 << 17, [("pane.to_world", SIZE, 0.6)]),  # fog has more noise
    deep(DIM | {"emission": rgb(*GLOW)}, 3.0, 1 << 18, [("pane.to_world", HEIGHT, 0.05), ("pane.to_world", SHIFT, 0.02)]),
    (DULL | {"emission": rgb(*GLOW)}, 30.0, 1 << 14, [("pane.to_world", HEIGHT, 0.05)])],
    ids=["before a floor", "camera before a floor", "size before a floor", "size in fog", "in a glow",
         "height in glowing fog"])
@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
def test_derivatives_by_a_mask_that_moves_are_those_of_differences(air, half, spp, moved):
    """Of edges of masks that a medium sees derivatives lack what a warning says (below): in fog they are far away."""
    scene, moves = under_a_smooth_mask(air, half), []
    for name, entry, step in moved:
        direction = torch.zeros(4, 4)
        direction[entry] = 1.0
        moves.append(Move(name, step, direction))
    for found in compared(scene, moves, spp=spp, batches=max(8, spp >> 13), along=True, max_depth=3, terms=("interior",)):
        found.assert_agrees(0.06, 3.5)


def test_a_warning_says_that_edges_of_panes_have_no_part_in_derivatives():
    scene = under_a_smooth_mask(DULL, 3.0)
    scene.pane.to_world.requires_grad_()
    with pytest.warns(rb.SilhouetteWarning, match="`pane.to_world` lack what these .* edges of what light passes"):
        rb.render(scene, spp=1)


@pytest.mark.parametrize("opacity", [
    {"type": "bitmap", "bitmap": SMOOTH, "raw": True, "filter_type": "trilinear"},
    torch.nn.Sequential(torch.nn.Linear(2, 1), torch.nn.Sigmoid())], ids=["trilinear", "network"])
def test_one_warning_says_which_panes_are_met_for_their_textures(opacity):
    """Not in empty space, where passing is a bounce everywhere, nor where others are read on the way."""
    def said(scene: rb.Scene) -> list[str]:
        renderer = rb.Renderer(scene.float(), spp=1, max_depth=2, compile=False)
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            for seed in range(2):
                renderer(seed=seed)
        return [str(each.message) for each in found if "without a bounce" in str(each.message)]

    message, = said(under_a_pane(mask(opacity)))
    assert "but not through `pane.bsdf`:" in message and "as `pane.bsdf.opacity`, are not read" in message
    empty = load(camera=overhead(2, 4.0, 0.7), sky={"type": "constant"},
                 pane=rectangle((0, 0, 1.0), 3.0, bsdf=mask(opacity)))
    read = mask({"type": "bitmap", "bitmap": SMOOTH, "raw": True}, CLAY)
    assert said(empty) == [] == said(under_a_pane(read))


@pytest.mark.parametrize("name, settings", [
    ("thin", {}), deep("thin", {"chunk": 40}), deep("thin", {"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)}),
    deep("thin", {"nee": False, "spp": 99}), deep("bitmap", {}), deep("bitmap", {"chunk": 40}),
    deep("bitmap", {"nee": False, "spp": 99}), deep("bitmap", {"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)})], ids=str)
def test_bounces_that_are_recorded_have_the_bits_of_single_operations(settings, name, monkeypatch):
    names = [*NAMES, f"ball.bsdf.{PARAMETERS[name][0]}"]
    assert_recorded_alike(lambda: room(PANES[name]).to(torch.float32), names, monkeypatch, **SETTINGS | settings)
