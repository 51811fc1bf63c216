"""Spectra as colours: those of Mitsuba in its RGB modes, or of its spectral modes where the others cannot render them."""

import math

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.io.documents import scene_dict, write_scene
from torch_radbp.plugin import REGISTRY
from torch_radbp.texture.observer import WAVELENGTHS
from torch_radbp.texture.spectrum import Samples

GREEN = [(400.0, 0.1), (500.0, 0.5), (700.0, 0.3)]
LARGE = [(400.0, 5.0), (500.0, 5.5), (700.0, 4.3)]
RGB_OF_GREEN, LIGHT_OF_GREEN = (0.3417438864707947, 0.47618773579597473, 0.2984713613986969), \
    (0.4223000407218933, 0.45279461145401, 0.2638430893421173)
USES = {
    "reflectance": (lambda value: {"type": "diffuse", "reflectance": value}, "reflectance"),
    "light": (lambda value: {"type": "point", "intensity": value}, "intensity"),
    "index": (lambda value: {"type": "conductor", "eta": value, "k": 1.0}, "eta"),
}


def loaded(use: str, value) -> torch.Tensor:
    """(3,) or () linear RGB of a texture in one of its places."""
    make, slot = USES[use]
    scene = rb.load_dict(scene_dict(subject=make(value)))
    return getattr(scene.subject, slot).colour().detach()


def spectrum(pairs) -> dict:
    return {"type": "spectrum", "value": pairs}


@pytest.mark.parametrize("use, pairs, expected", [
    ("reflectance", GREEN, RGB_OF_GREEN),
    ("light", GREEN, LIGHT_OF_GREEN),
    ("index", LARGE, (4.5928425788879395, 5.283289432525635, 5.257214546203613)),
    ("reflectance", [(360, 0.5), (830, 0.5)], (0.4994926452636719, 0.4994368553161621, 0.499400794506073)),
    ("light", [(360, 0.5), (830, 0.5)], (0.6024418473243713, 0.4741140902042389, 0.4546334147453308)),
    ("reflectance", [(200, 0.2), (1500, 0.3)], (0.23379524052143097, 0.22612959146499634, 0.2182634174823761)),
    ("light", [(900, 0.2), (1500, 0.3)], (0.0, 0.0, 0.0)),
])
def test_a_list_has_the_colour_of_mitsuba(use, pairs, expected):
    """Printed by Mitsuba 3.9.1, `scalar_rgb`, for each of `USES`:

        print(mi.traverse(mi.load_dict(use({"type": "spectrum", "value": pairs}))))
    """
    torch.testing.assert_close(loaded(use, spectrum(pairs)), torch.tensor(expected), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("use", USES)
@pytest.mark.filterwarnings("ignore:a spectrum has a colour outside of sRGB")
def test_random_lists_have_the_colours_of_mitsuba(mi, use):
    make, slot = USES[use]
    mi.set_log_level(mi.LogLevel.Error)
    generator = np.random.default_rng(1)
    for _ in range(20):
        nodes = np.sort(generator.uniform(330, 860, generator.integers(2, 20)))
        pairs = list(zip(nodes.tolist(), generator.uniform(0, 1.2, len(nodes)).tolist()))
        expected = np.array(mi.traverse(mi.load_dict(make(spectrum(pairs))))[f"{slot}.value"])
        np.testing.assert_allclose(loaded(use, spectrum(pairs)).numpy(), expected, rtol=2e-6, atol=1e-6)


@pytest.mark.parametrize("element", [
    '<spectrum name="reflectance" value="400:0.1, 500:0.5, 700:0.3"/>',
    '<spectrum name="reflectance" value="400:0.1 500:.5 700:3e-1"/>',
    '<spectrum name="reflectance" filename="green.spd"/>',
    '<spectrum type="irregular" name="reflectance"><string name="wavelengths" value="400, 500, 700"/>'
    '<string name="values" value="0.1 0.5 0.3"/></spectrum>',
    '<texture type="irregular" name="reflectance"><spectrum name="value" value="400:0.1, 500:0.5, 700:0.3"/></texture>',
])
def test_every_spelling_in_xml(tmp_path, element):
    (tmp_path / "green.spd").write_text("# wavelength value\n400 0.1\n500 0.5 # the top\n\n 700 0.3")
    bsdf = f'<bsdf type="diffuse" id="green">{element}</bsdf>'
    colour = rb.load(write_scene(tmp_path, bsdf)).green.reflectance.colour().detach()
    torch.testing.assert_close(colour, torch.tensor(RGB_OF_GREEN), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("text, message", [
    ("400 0.1\n500 0.2 0.3\n", r"bad.spd, line 2: a line must have a wavelength and a value, got 3 words"),
    ("400 0.1\n500 high\n", r"bad.spd, line 2: expected a finite number, got 'high'"),
    ("500 0.1\n400 0.1\n", r"bad.spd: the wavelengths of a spectrum must increase, got 500 and then 400"),
    ("# nothing\n", r"bad.spd: a spectrum must have at least two wavelengths, got 0"),
])
def test_a_bad_file_is_named_with_its_line(tmp_path, text, message):
    (tmp_path / "bad.spd").write_text(text)
    wall = {"type": "diffuse", "reflectance": {"type": "spectrum", "filename": "bad.spd"}}
    with pytest.raises(rb.SceneError, match=message):
        rb.load_dict(scene_dict(wall=wall), base_dir=tmp_path)


@pytest.mark.parametrize("plugin", [
    {"type": "irregular", "wavelengths": [400.0, 500, 700], "values": [0.1, 0.5, 0.3]},
    {"type": "irregular", "value": spectrum(GREEN)},
    {"type": "regular", "wavelength_min": 400, "wavelength_max": 700, "values": "0.1, 0.5, 0.4, 0.3"},
    {"type": "regular", "value": spectrum([(400, 0.1), (500, 0.5), (600, 0.4), (700, 0.3)])},
], ids=lambda plugin: " ".join(plugin))
def test_a_plugin_has_the_colours_of_the_list_that_it_stands_for(plugin):
    torch.testing.assert_close(loaded("reflectance", plugin), torch.tensor(RGB_OF_GREEN), rtol=1e-6, atol=1e-7)
    torch.testing.assert_close(loaded("light", plugin), torch.tensor(LIGHT_OF_GREEN), rtol=1e-6, atol=1e-7)
    texture = rb.load_dict(scene_dict(s=USES["light"][0](plugin))).s.intensity
    assert [name for name, _ in texture.named_parameters()] == ["values"]


@pytest.mark.parametrize("attributes, expected", [
    ({"temperature": 5000.0}, (15262.986328125, 12082.5546875, 9592.56640625)),
    ({"temperature": 2700.0, "wavelength_min": 450.0, "wavelength_max": 620.0},
     (170.9761505126953, 144.48912048339844, 14.43844223022461)),
])
def test_a_black_body_has_the_colour_of_mitsubas_spectral_modes(attributes, expected):
    """The image of a constant emitter, without its noise; by Mitsuba 3.9.1, `scalar_spectral`, with s = mi.load_dict(...):

        def power(nm): si.wavelengths = [nm] * 4; return s.eval(si)[0]
        print(mi.spectrum_list_to_srgb(WAVELENGTHS, [power(nm) for nm in WAVELENGTHS], False))
    """
    found = loaded("light", {"type": "blackbody"} | attributes)
    torch.testing.assert_close(found, torch.tensor(expected), rtol=1e-5, atol=0)


def test_a_black_body_is_that_of_mitsuba_at_any_temperature(mi):
    mi.set_variant("scalar_spectral")
    try:
        for temperature in (800.0, 2000.0, 6504.0, 30000.0):
            glow = {"type": "blackbody", "temperature": temperature}
            theirs, si = mi.load_dict(glow), mi.SurfaceInteraction3f()
            power = []
            for wavelength in WAVELENGTHS:
                si.wavelengths = [float(wavelength)] * 4
                power.append(float(theirs.eval(si)[0]))
            expected = np.array(mi.spectrum_list_to_srgb(WAVELENGTHS.tolist(), power, False))
            np.testing.assert_allclose(loaded("light", glow).numpy(), expected, rtol=1e-4)
    finally:
        mi.set_variant("scalar_rgb")


@pytest.mark.parametrize("plugin, value", [
    ({"type": "d65"}, 1.0),
    ({"type": "d65", "scale": 0.25}, 0.25),
    ({"type": "d65", "color": {"type": "rgb", "value": [0.1, 0.2, 0.3]}, "scale": 2.0}, [0.2, 0.4, 0.6]),
    ({"type": "uniform", "value": 0.3}, 0.3),
    ({"type": "uniform", "value": 0.3, "wavelength_min": 400, "wavelength_max": 500}, 0.3),
    ({"type": "srgb", "color": {"type": "rgb", "value": [0.1, 0.2, 0.3]}}, [0.1, 0.2, 0.3]),
    ({"type": "rawconstant", "value": 0.3}, 0.3),
    ({"type": "rawconstant", "value": [0.1, 0.2, 0.3]}, [0.1, 0.2, 0.3]),
], ids=lambda part: " ".join(part) if isinstance(part, dict) else "")
@pytest.mark.parametrize("use", USES)
def test_plugins_of_constants_are_those_of_mitsuba(use, plugin, value):
    """Printed by Mitsuba 3.9.1, `scalar_rgb`: print(mi.traverse(mi.load_dict(use(plugin)))); the same in each of `USES`."""
    assert loaded(use, plugin).tolist() == pytest.approx(value)
    make, slot = USES[use]
    assert f"subject.{slot}.value" in dict(rb.load_dict(scene_dict(subject=make(plugin))).named_parameters())


@pytest.mark.parametrize("plugin", [
    {"type": "irregular", "wavelengths": [380.0, 470, 520, 710], "values": [0.6, 0.3, 0.5, 0.4]},
    {"type": "regular", "wavelength_min": 400, "wavelength_max": 700, "values": [0.3, 0.5, 0.4]},
    {"type": "blackbody", "temperature": 3000.0},
], ids=lambda plugin: plugin["type"])
@pytest.mark.parametrize("use", USES)
def test_gradcheck_of_what_a_spectrum_is_made_of(plugin, use):
    if plugin["type"] == "blackbody" and use != "light":
        return
    make, slot = USES[use]
    texture = getattr(rb.load_dict(scene_dict(subject=make(plugin))).to(torch.float64).subject, slot)
    (name, value), = texture.named_parameters()

    def colour(value):
        return torch.func.functional_call(_Colour(texture), {f"texture.{name}": value}, ())

    assert torch.autograd.gradcheck(colour, [value.detach().clone().requires_grad_()], eps=1e-4, rtol=1e-6)


class _Colour(torch.nn.Module):
    def __init__(self, texture):
        super().__init__()
        self.texture = texture

    def forward(self):
        return self.texture.colour()


@pytest.mark.parametrize("temperature", [1e-3, 1.0, 500.0, 1e7])
def test_a_black_body_and_its_derivative_are_finite_at_every_temperature(temperature):
    scene = rb.load_dict(scene_dict(subject=USES["light"][0]({"type": "blackbody", "temperature": temperature})))
    parameter = scene.subject.intensity.temperature.requires_grad_()
    colour = scene.subject.intensity.colour()
    colour.sum().backward()
    assert torch.isfinite(colour).all() and math.isfinite(parameter.grad)


def test_a_colour_outside_of_srgb_is_clipped_with_a_warning():
    pure = [(500.0, 0.1), (510.0, 1.0), (515.0, 1.0), (600.0, 0.1)]
    for value in (spectrum(pure), {"type": "irregular", "value": spectrum(pure)}):
        with pytest.warns(UserWarning, match="a spectrum has a colour outside of sRGB, linear -.*, and is clipped"):
            assert loaded("reflectance", value).min() == 0
    with pytest.warns(UserWarning, match="outside of sRGB"):
        assert loaded("reflectance", spectrum([(360, 2.0), (830, 2.0)])).tolist() == [1, 1, 1]


def test_one_spectrum_cannot_be_light_and_paint():
    green = {"type": "irregular", "value": spectrum(GREEN)}
    ref = {"type": "ref", "id": "green"}
    with pytest.raises(rb.SceneError, match="the irregular spectrum is emitted in one place and reflected in another"):
        rb.load_dict(scene_dict(green=green, sky={"type": "constant", "radiance": ref},
                                wall={"type": "diffuse", "reflectance": ref}))


def test_a_value_out_of_range_is_found_when_rendering():
    scene = rb.load_dict(scene_dict(sky={"type": "constant", "radiance": {"type": "blackbody", "temperature": 900.0}},
                                    ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {
                                        "type": "irregular", "value": spectrum(GREEN)}}}))
    rb.render(scene, spp=1, max_depth=2)
    with torch.no_grad():
        scene.ball.bsdf.reflectance.values.fill_(-1)
    with pytest.raises(ValueError, match="'ball.bsdf.reflectance.values' must be at least 0, got -1"):
        rb.render(scene, spp=1)
    with torch.no_grad():
        scene.ball.bsdf.reflectance.values.fill_(0.5)
        scene.sky.radiance.temperature.fill_(0)
    with pytest.raises(ValueError, match="'sky.radiance.temperature' must be greater than 0, got 0"):
        rb.render(scene, spp=1)


def test_a_saved_scene_has_the_same_colours(tmp_path):
    wall = {"type": "plastic", "diffuse_reflectance": {"type": "irregular", "value": spectrum(GREEN)},
            "specular_reflectance": {"type": "regular", "wavelength_min": 400, "wavelength_max": 700, "values": [0.3, 0.5]}}
    scene = rb.load_dict(scene_dict(
        wall=wall, sky={"type": "constant", "radiance": {"type": "blackbody", "temperature": 900.0}},
        metal={"type": "conductor", "eta": {"type": "d65", "scale": 2.0}, "k": {"type": "rawconstant", "value": [3, 2, 1]}},
        raw={"type": "rawconstant", "value": 0.5}))
    rb.save(scene, tmp_path / "scene.xml")
    saved = rb.load(tmp_path / "scene.xml")
    for name, value in scene.named_parameters():
        torch.testing.assert_close(saved.get_parameter(name), value, msg=name)
    assert "d65" not in (tmp_path / "scene.xml").read_text() and saved.wall.diffuse_reflectance.type == "irregular"


@pytest.mark.parametrize("samples, message", [
    (Samples((400.0, 500.0), (1.0,)), "as many values as wavelengths, got 1 and 2"),
    (Samples((400.0, math.nan), (1.0, 1.0)), "finite numbers, got nan"),
    (Samples((400.0, 400.0), (1.0, 1.0)), "must increase, got 400 and then 400"),
])
def test_samples_are_checked(samples, message):
    with pytest.raises(ValueError, match=message):
        samples.check()


def test_the_plugins_are_registered_as_textures():
    assert {"regular", "irregular", "blackbody", "d65", "uniform", "srgb", "rawconstant", "rgb"} <= set(REGISTRY["texture"])
