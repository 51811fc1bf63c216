"""What the constructors accept, what they call their parameters, and what they hand to the tracer."""

import copy

import pytest
import torch

import torch_radbp as rb
from tests.bsdf.lanes import directions, material, values_of
from tests.io.documents import scene_dict
from tests.scenes import load, rectangle, rgb, sensor
from tests.scenes.materials import MATERIALS, as_dict
from torch_radbp.bsdf.blendbsdf import BlendBSDF
from torch_radbp.bsdf.conductor import Conductor
from torch_radbp.bsdf.dielectric import Dielectric
from torch_radbp.bsdf.mask import Mask
from torch_radbp.bsdf.normalmap import NormalMap
from torch_radbp.bsdf.null import Null
from torch_radbp.bsdf.plastic import Plastic
from torch_radbp.bsdf.principled import Principled
from torch_radbp.bsdf.principledthin import PrincipledThin
from torch_radbp.bsdf.roughconductor import RoughConductor
from torch_radbp.bsdf.roughdielectric import RoughDielectric
from torch_radbp.bsdf.roughplastic import RoughPlastic
from torch_radbp.bsdf.thindielectric import ThinDielectric
from torch_radbp.bsdf.twosided import TwoSided
from torch_radbp.scene.packing.radiances import BankBuilder
from torch_radbp.texture.bitmap import Bitmap, texture_bank

BAD = {
    "unknown metal": (Conductor, {"material": "Ag2"}, "material 'Ag2' is not known.*did you mean 'Ag'"),
    "metal and index": (Conductor, {"material": "Ag", "k": 2.0}, "either material or eta and k, got material 'Ag' and k"),
    "negative k": (RoughConductor, {"k": -1.0}, "k must be at least 0, got -1"),
    "negative mirror": (Conductor, {"specular_reflectance": -0.5}, "specular_reflectance must be at least 0, got -0.5"),
    "unknown glass": (Dielectric, {"int_ior": "bk8"}, "int_ior 'bk8' is not known.*did you mean 'bk7'"),
    "no index": (Dielectric, {"ext_ior": 0.0}, "ext_ior must be greater than 0 and finite, got 0"),
    "nan": (RoughDielectric, {"int_ior": float("nan")}, "int_ior must be greater than 0 and finite, got nan"),
    "equal indices": (RoughDielectric, {"int_ior": "water", "ext_ior": 1.333}, "int_ior and ext_ior must differ"),
    "unknown distribution": (RoughConductor, {"distribution": "phong"}, "distribution 'phong' is not known.*beckmann, ggx"),
    "hidden normals": (RoughDielectric, {"sample_visible": 0}, "sample_visible must be True or False, got 0"),
    "half of a roughness": (RoughConductor, {"alpha_u": 0.1}, "alpha_u and alpha_v must be given both"),
    "three roughnesses": (RoughDielectric, {"alpha": 0.1, "alpha_u": 0.1, "alpha_v": 0.1}, "either alpha, or alpha_u and"),
    "equal indices of plastic": (RoughPlastic, {"int_ior": 1.5, "ext_ior": 1.5}, "int_ior and ext_ior must differ"),
    "no roughness of plastic": (RoughPlastic, {"alpha": -0.1}, "alpha must be at least 0, got -0.1"),
    "unknown plastic": (Plastic, {"int_ior": "polypropylen"}, "int_ior 'polypropylen' is not known.*'polypropylene'"),
    "negative base": (Plastic, {"diffuse_reflectance": -0.5}, "diffuse_reflectance must be at least 0, got -0.5"),
    "shifted a bit": (Plastic, {"nonlinear": 1}, "nonlinear must be True or False, got 1"),
    "hidden normals of plastic": (RoughPlastic, {"sample_visible": 1}, "sample_visible must be True or False, got 1"),
    "index twice": (Principled, {"eta": 1.5, "specular": 0.5}, "either eta or specular.*got 1.5 and 0.5"),
    "much metal": (Principled, {"metallic": 1.5}, r"metallic must be in \[0, 1\], got 1.5"),
    "much specular": (Principled, {"specular": 4.5}, r"specular must be in \[0, 4\], got 4.5"),
    "never sampled": (Principled, {"main_specular_sampling_rate": 0.0}, "specular_sampling_rate must be greater than 0"),
    "sampled less than never": (Principled, {"clearcoat_sampling_rate": -1.0}, "clearcoat_sampling_rate must be at least 0"),
    "both sides of principled glass": (TwoSided, {"brdf": [Principled(spec_trans=0.5)]}, "only reflect, got 'principled'"),
    "much through": (PrincipledThin, {"diff_trans": 2.5}, r"diff_trans must be in \[0, 2\], got 2.5"),
    "no index of a sheet": (PrincipledThin, {"eta": 0.0}, "eta must be greater than 0, got 0"),
    "sheet never sampled": (PrincipledThin, {"diffuse_reflectance_sampling_rate": 0.0}, "must be greater than 0 and finite"),
    "both sides of a sheet": (TwoSided, {"brdf": [PrincipledThin()]}, "only reflect, got 'principledthin'"),
    "one in a blend": (BlendBSDF, {"weight": 0.5, "bsdf": [Plastic()]}, r"blendbsdf takes two BSDFs, got \['plastic'\]"),
    "three in a blend": (BlendBSDF, {"weight": 0.5, "bsdf": [Plastic()] * 3}, "blendbsdf takes two BSDFs, got"),
    "too much of a blend": (BlendBSDF, {"weight": 1.5, "bsdf": [Plastic()] * 2}, r"weight must be in \[0, 1\], got 1.5"),
    "too opaque": (Mask, {"opacity": -0.5, "nested_bsdf": Plastic()}, r"opacity must be in \[0, 1\], got -0.5"),
    "number for a truth": (NormalMap, {"normalmap": 0.5, "nested_bsdf": Plastic(), "flip_invalid_normals": 1},
                           "flip_invalid_normals must be True or False, got 1"),
    "both sides of holes": (TwoSided, {"brdf": [Mask(nested_bsdf=Plastic())]}, "only reflect, got 'mask'"),
    "both sides of nothing": (TwoSided, {"brdf": [Null()]}, "only reflect, got 'null'"),
    "both sides of glass": (TwoSided, {"brdf": [BlendBSDF(weight=0.5, bsdf=[Plastic(), Dielectric()])]},
                            "only reflect, got 'blendbsdf'"),
    "negative roughness": (RoughConductor, {"alpha": -0.1}, "alpha must be at least 0, got -0.1"),
}


@pytest.mark.parametrize("cls, attributes, message", BAD.values(), ids=BAD)
def test_bad_attributes_are_named(cls, attributes, message):
    with pytest.raises(ValueError, match=message):
        cls(**attributes)


def test_defaults_are_those_of_mitsuba():
    """Recorded from `mi.traverse(mi.load_dict({"type": ...}))`."""
    def figures(bsdf):
        return {name: round(value.item(), 5) for name, value in bsdf.named_parameters()}

    mirror = {"eta.value": 0.0, "k.value": 1.0, "specular_reflectance.value": 1.0}
    assert figures(Conductor()) == mirror
    assert figures(RoughConductor()) == {"alpha.value": 0.1, **mirror}
    glass = {"eta": 1.50418, "specular_reflectance.value": 1.0, "specular_transmittance.value": 1.0}
    assert figures(Dielectric()) == figures(ThinDielectric()) == glass
    assert figures(RoughDielectric()) == {"alpha.value": 0.1, **glass}
    coat = {"eta": 1.48959, "diffuse_reflectance.value": 0.5, "specular_reflectance.value": 1.0}
    assert figures(Plastic()) == coat
    assert figures(RoughPlastic()) == {**coat, "alpha": 0.1}
    assert not Plastic().nonlinear and not RoughPlastic().nonlinear and RoughPlastic().distribution == "beckmann"
    assert RoughConductor().distribution == RoughDielectric().distribution == "beckmann"
    shares = ("anisotropic", "metallic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss",
              "flatness")
    burley = {"base_color.value": 0.5, "roughness.value": 0.5, **{f"{name}.value": 0.0 for name in shares}}
    assert figures(Principled()) == {**burley, "specular": 0.5}
    assert figures(Principled(eta=1.3)) == {**burley, "eta": 1.3}
    thin = {name: value for name, value in burley.items() if not name.startswith(("metallic", "clearcoat"))}
    assert figures(PrincipledThin()) == {**thin, "diff_trans.value": 0.0, "eta.value": 1.5}
    assert figures(Mask(nested_bsdf=Conductor())) == {
        "opacity.value": 0.5, **{f"nested_bsdf.{name}": value for name, value in mirror.items()}}
    bumps = NormalMap(normalmap=1.0, nested_bsdf=Conductor())
    assert bumps.flip_invalid_normals and bumps.use_shadowing_function
    assert not any(p.requires_grad for bsdf in (Dielectric(), RoughConductor()) for p in bsdf.parameters())


@pytest.mark.parametrize("name", MATERIALS)
def test_a_kind_is_a_hashable_value_and_counts_its_textures(name):
    one, other = material(MATERIALS[name]), material(MATERIALS[name])
    assert one.kind() == other.kind() and hash(one.kind()) == hash(other.kind())
    assert len(one.textures()) == one.kind().slots
    assert all(a is b for a, b in zip(one.textures(), one.textures()))  # what a table of textures is keyed by


def options(value):
    """What of a description is not a number or a colour."""
    if isinstance(value, list):
        return tuple(map(options, value)) if isinstance(value[0], dict) else None
    if not isinstance(value, dict):
        return None
    names = ("type", "distribution", "nonlinear", "flip_invalid_normals", "use_shadowing_function", "sample_visible")
    if value["type"].startswith("principled"):
        return value["type"], tuple(sorted(value)), *(value[name] for name in value if name.endswith("_rate"))
    return ("alpha_u" in value, *(value.get(name) for name in names),
            *(options(value[name]) for name in sorted(value) if options(value[name]) is not None))


def test_kinds_differ_by_their_options():
    defaults = {"roughconductor": {"distribution": "beckmann"}, "roughdielectric": {"distribution": "beckmann"},
                "plastic": {"nonlinear": False}, "roughplastic": {"distribution": "beckmann", "nonlinear": False}}
    described = [options(defaults.get(description["type"], {}) | description) for description in MATERIALS.values()]
    kinds = [material(description).kind() for description in MATERIALS.values()]
    assert len(set(kinds)) == len(set(described)) == len(set(zip(kinds, described))) > 12


def test_the_index_of_glass_is_one_parameter_with_a_gradient():
    glass = Dielectric(int_ior=1.5, ext_ior=1.0).double()
    glass.eta.requires_grad_()
    bank = BankBuilder()
    index = bank.add(glass.textures()[0])
    texels = texture_bank(bank.textures, torch.float64, torch.device("cpu")).texels
    assert not bank.has_bitmaps
    gradient, = torch.autograd.grad(texels.x[index] * 3, glass.eta)
    assert gradient.shape == () and gradient == 3
    replaced = torch.func.functional_call(_Texel(glass), {"glass.eta": torch.tensor(2.0)}, ())
    assert replaced == 2
    twin = copy.deepcopy(glass)
    with torch.no_grad():
        twin.eta.fill_(1.25)
    assert twin.textures()[0].texels()[0, 0, 0] == 1.25 and glass.textures()[0].texels()[0, 0, 0] == 1.5
    assert twin.int_ior == 1.25


class _Texel(torch.nn.Module):
    def __init__(self, glass):
        super().__init__()
        self.glass = glass

    def forward(self):
        return self.glass.textures()[0].texels()[0, 0, 0]


def test_what_is_zero_is_absent_until_it_is_given_or_differentiated():
    """A parameter of a principled material that does nothing costs nothing, but its derivative is right."""
    bsdf = Principled(metallic=0.0, sheen_tint=0.5, clearcoat_gloss=0.5)
    assert bsdf.kind().features == () and len(bsdf.textures()) == 3 and not bsdf.kind().transmits
    assert bsdf.kind() == Principled(sheen=0.0).kind() != Principled(sheen=0.1).kind()
    bsdf.sheen.value.data.fill_(0.2)
    assert bsdf.kind().features == ("sheen", "sheen_tint")
    bsdf.spec_trans.value.requires_grad_()
    assert bsdf.kind().features == ("spec_trans", "sheen", "sheen_tint") and bsdf.kind().transmits
    assert Principled(metallic=Bitmap(data=torch.zeros(2, 2))).kind().features == ("metallic",)
    with torch.autograd.forward_ad.dual_level():
        tangent = torch.autograd.forward_ad.make_dual(torch.zeros(()), torch.ones(()))
        kind = torch.func.functional_call(_Kind(Principled()), {"bsdf.metallic.value": tangent}, ())
        assert kind.features == ("metallic",)


def test_a_parameter_that_leaves_zero_is_seen_by_the_next_rendering():
    def scene(metallic):
        return load(sensor=sensor(4), it={"type": "principled", "metallic": metallic, "base_color": 0.2},
                    plate=rectangle((0, 0, 0), bsdf={"type": "ref", "id": "it"}),
                    sky={"type": "constant", "radiance": rgb(1, 2, 3)})

    renderer = rb.Renderer(scene(0.0), spp=4, max_depth=3)
    dull = renderer(seed=1)
    metallic = renderer.scene.get_parameter("it.metallic.value")
    metallic.data.fill_(0.75)
    metal = renderer(seed=1)
    assert torch.equal(metal, rb.render(scene(0.75), spp=4, max_depth=3, seed=1)) and not torch.equal(metal, dull)
    metallic.data.fill_(0.0)
    assert torch.equal(renderer(seed=1), dull)
    metallic.requires_grad_()
    gradient, = torch.autograd.grad(renderer(seed=1).sum(), metallic)
    assert gradient != 0


class _Kind(torch.nn.Module):
    def __init__(self, bsdf):
        super().__init__()
        self.bsdf = bsdf

    def forward(self):
        return self.bsdf.kind()


def test_textures_may_stand_for_every_number_but_the_index():
    image = Bitmap(data=torch.full((2, 3, 3), 0.2))
    rough = RoughConductor(alpha=image, eta=image, k=image, specular_reflectance=image)
    assert rough.textures()[0].texture is image and rough.textures()[1:] == (image,) * 3
    brushed = RoughDielectric(alpha_u=image, alpha_v=0.3, specular_transmittance=image)
    assert brushed.textures()[0].texture is image and brushed.kind().anisotropic


def scene_of(description: dict) -> rb.Scene:
    """A disk of a material called `it`."""
    return rb.load_dict(scene_dict(it=as_dict(description), ball={"type": "disk", "bsdf": {"type": "ref", "id": "it"}}))


@pytest.mark.parametrize("name", MATERIALS)
def test_the_loader_knows_the_materials(name):
    """By the schema alone: numbers, colours, names."""
    scene = scene_of(MATERIALS[name])
    expected = material(MATERIALS[name]).float()
    for key, value in expected.named_parameters():
        torch.testing.assert_close(scene.get_parameter(f"it.{key}"), value)


@pytest.mark.parametrize("name", MATERIALS)
def test_a_saved_material_is_the_same(name, tmp_path):
    scene = scene_of(MATERIALS[name])
    with torch.no_grad():
        for parameter in scene.it.parameters():
            parameter.mul_(0.9)
    rb.save(scene, tmp_path / "scene.xml")
    again = rb.load(tmp_path / "scene.xml")
    assert again.it.kind() == scene.it.kind()
    for key, value in scene.it.named_parameters():
        assert torch.equal(again.get_parameter(f"it.{key}"), value), key


def test_two_sides_may_let_light_through_if_asked():
    """As in Mitsuba: from behind, glass is seen as from its front."""
    glass = {"type": "roughdielectric", "alpha": 0.3}
    both, single = TwoSided(brdf=[material(glass)], allow_transmission=True), material(glass)
    wi, wo = directions(500, 1), directions(500, 2)
    found = both.kind().eval(values_of(both, wi.z), wi, wo)
    side = torch.sign(wi.z)
    expected = single.kind().eval(values_of(single, wi.z), wi._replace(z=wi.z * side), wo._replace(z=wo.z * side))
    assert both.kind().transmits and expected.x.max() > 0.1 and (expected.x[wi.z * wo.z < 0] > 0).any()
    assert torch.equal(found.stack(), expected.stack())


def test_a_two_sided_pane_is_the_same_from_both_sides_in_an_image():
    glass = {"type": "twosided", "allow_transmission": True, "glass": {"type": "dielectric"}}
    lamp = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}}
    images = [rb.render(load(torch.float64, sensor=sensor(2, (0, 0, 3.0 * side), fov=5), lamp=lamp, pane=rectangle(
        (0, 0, 0), bsdf=glass)), spp=64, max_depth=3, seed=1) for side in (1, -1)]
    assert images[0].min() > 0.3
    torch.testing.assert_close(images[0].mean((0, 2, 3)), images[1].mean((0, 2, 3)), rtol=0.05, atol=0)
