"""A material that does what it says agrees; those that do not are found out by the check that is for it."""

import pytest
import torch

import torch_radbp as rb
from tests.check.broken import BROKEN, Felt, choosing, cosine, felt, mirror, scattering
from tests.deep import deep_but
from tests.scenes import load, rectangle, sensor
from torch_radbp.interface.bsdf import LobeChoice
from torch_radbp.plugin import REGISTRY, register

QUICK = {"samples": 10_000}


def test_a_right_material_agrees():
    with felt() as description:
        result = rb.check_bsdf(description)
    assert result.agrees and not result.failed, str(result)
    assert result.plugin == "bsdf felt" and str(result).endswith("\nagrees")
    assert [finding.check for finding in result.findings] == ["density", "samples", "weight", "lobes", "methods",
                                                              "reciprocity", "energy", "statements", "finite"]


# Of those that the same figures betray one is quick.
LIKE_OTHERS = ("half of the density", "a density of something else", "samples around wi", "samples that are no numbers",
               "a mirror that is chosen half the time", "a density without bound")


@pytest.mark.parametrize("name", deep_but([name for name in BROKEN if name not in LIKE_OTHERS], BROKEN))
def test_what_is_wrong_is_found(name):
    changes, expected = BROKEN[name]
    with felt(**changes) as description:
        result = rb.check_bsdf(description, **QUICK)
    assert set(result.failed) == expected, str(result)
    assert f"disagrees: {', '.join(result.failed)}" in str(result)


def test_half_of_the_density_is_rendered_without_a_word_but_found():
    """The image is brighter, its derivative is that of the brighter image; the material alone tells."""
    def scene(kind):
        return load(sensor=sensor(4), plate=rectangle((0, 0, 0), bsdf={"type": kind, "reflectance": 0.5}),
                    sky={"type": "constant"})

    changes, _ = BROKEN["half of the density"]
    with felt(**changes) as description:
        wrong, right = (rb.render(scene(kind), spp=64, max_depth=2).mean() for kind in ("felt", "diffuse"))
        assert wrong > 1.2 * right
        figures = {finding.check: finding.figures for finding in rb.check_bsdf(description, **QUICK).findings}
    assert "pdf integrates to 0.5000, of the samples 1.0000 have one" in figures["density"]
    assert "samples reflect 1.0000 by eval / pdf, eval integrates to 0.5000" in figures["weight"]


def test_a_right_mirror_agrees():
    with felt(**mirror()) as description:
        result = rb.check_bsdf(description, **QUICK)
    assert result.agrees, str(result)


@pytest.mark.parametrize("name, claim", [("light out of nothing", "conserves"),
                                         ("light that favours one direction", "reciprocal")])
def test_what_a_model_does_not_claim_is_reported_and_no_error(name, claim):
    with felt(**BROKEN[name][0], **{claim: False}) as description:
        result = rb.check_bsdf(description, **QUICK)
    assert result.agrees and "not claimed" in str(result), str(result)


def test_two_lobes_that_are_chosen_as_they_say_agree():
    with felt(**choosing(0.3)) as description:
        assert rb.check_bsdf(description, **QUICK).agrees


def test_a_material_of_a_scene_is_checked_as_it_is_and_left_so():
    scene = load(sensor=sensor(4), plate=rectangle((0, 0, 0), bsdf={
        "type": "roughconductor", "alpha": {"type": "bitmap", "data": torch.tensor([[0.1, 0.3], [0.4, 0.2]])}}),
        sky={"type": "constant"})
    alpha = scene.get_parameter("plate.bsdf.alpha.data").requires_grad_()
    before = alpha.detach().clone()
    result = rb.check_bsdf(scene.plate.bsdf, **QUICK)
    assert result.agrees, str(result)
    assert torch.equal(alpha, before) and alpha.requires_grad and alpha.grad is None and alpha.dtype == before.dtype


def test_the_same_seed_gives_the_same_outcome():
    first, second, other = (rb.check_bsdf({"type": "diffuse"}, seed=seed, **QUICK) for seed in (1, 1, 2))
    assert first == second != other and other.agrees


def test_a_sharp_lobe_is_integrated():
    """Seen from above its peak is 1e-3 wide."""
    assert rb.check_bsdf({"type": "roughconductor", "alpha": 1e-3}, **QUICK).agrees


@pytest.mark.parametrize("arguments, message", [
    (({"type": "constant"},), "'constant' is an emitter, which cannot stand here"),
    ((3.0,), "bsdf must be a material or a dict that describes one, got a float"),
    (({"type": "diffuse"}, {"samples": 10}), "samples must be an integer of at least 10000, got 10"),
], ids=str)
@pytest.mark.hostile
def test_wrong_arguments_are_named(arguments, message):
    what, settings = arguments if len(arguments) == 2 else (*arguments, {})
    with pytest.raises((TypeError, ValueError), match=message):
        rb.check_bsdf(what, **settings)


def branch(self, values, wi, wo, fixed_lobes=False):
    return (values[0] * cosine(wi, wo), cosine(wi, wo)) if wi.z > 0 else (values[0] * 0.0, wo.z * 0)


CONTRACT = {
    "too few slots": ({"slots": 1}, "slots of FeltKind must be the number of textures.., which is 2, got 1"),
    "too many slots": ({"slots": 3}, "slots of FeltKind must be the number of textures"),
    "a value that is not there": (scattering(lambda values, wi, wo: values[2].x),
                                  "FeltKind.eval_pdf raised IndexError: .*as many values as `slots` says, 2"),
    "one result": ({"eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: values[0] * cosine(wi, wo)},
                   "FeltKind.eval_pdf must return two results, .*, got a Vec3 alone"),
    "three results": ({"eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: (values[0], wo.z, wo.z)},
                      "FeltKind.eval_pdf must return two results, .*, got 3 results"),
    "a Python if": ({"eval_pdf": branch}, "the bsdf 'felt': FeltKind.eval_pdf raised RuntimeError: Boolean value .* use "
                                          "torch.where or a product, no Python `if`"),
    "a number for a density": ({"eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: (values[0], 0.3)},
                               "FeltKind.eval_pdf: the second result, the density, must be a tensor .*, got a float"),
    "a tensor for a colour": ({"eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: (wo.z, wo.z)},
                              "FeltKind.eval_pdf: the first result must be a Vec3, got a Tensor"),
    "another shape": ({"eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: (values[0], wo.z[:, None])},
                      r"the density, must have shape \(N,\) as the directions, \(.*\), got \(.*, 1\)"),
    "another dtype": ({"eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: (values[0], wo.z.half())},
                      "the density, must be torch.float.* on cpu as the directions, got torch.float16 on cpu"),
    "a stacked sample": ({"sample": lambda self, values, wi, choice, u, v: torch.stack([u, v, u], -1)},
                         "FeltKind.sample: the result must be a Vec3, got a Tensor of shape"),
    "a bare number for a choice": ({"choose": lambda self, values, wi, choice, u, v: u},
                                   "FeltKind.choose must return a LobeChoice, got a Tensor"),
    "a choice without saying which is delta": ({"delta": True, "choose": lambda self, values, wi, choice, u, v: LobeChoice(
        torch.zeros_like(u), torch.ones_like(u))}, "FeltKind.choose must say in `delta` which lanes picked a delta lobe"),
    "no specular": ({"delta": True, "choose": lambda self, values, wi, choice, u, v: LobeChoice(
        torch.zeros_like(u), torch.ones_like(u), u > 0.5)}, "FeltKind.specular raised TypeError: .* has no delta lobe"),
}


@pytest.mark.parametrize("where", ["in check_bsdf", "in a rendering"])
@pytest.mark.parametrize("name", CONTRACT)
@pytest.mark.hostile
def test_a_broken_contract_names_plugin_and_method(name, where):
    changes, message = CONTRACT[name]
    with felt(**changes) as description, pytest.raises((TypeError, ValueError), match=message) as caught:
        if where == "in check_bsdf":
            rb.check_bsdf(description, **QUICK)
        rb.render(load(sensor=sensor(4), plate=rectangle((0, 0, 0), bsdf=description), sky={"type": "constant"}), spp=1)
    assert "the bsdf 'felt'" in str(caught.value)


@pytest.mark.hostile
def test_a_texture_without_a_domain_is_named():
    register("bsdf", "felt")(type("Felt", (Felt,), {"domains": lambda self: {}, "__init__": Felt.__init__}))
    try:
        with pytest.raises(TypeError, match=r"domains\(\) of a felt must say which values 'reflectance' may have"):
            REGISTRY["bsdf"]["felt"]()
    finally:
        del REGISTRY["bsdf"]["felt"]
