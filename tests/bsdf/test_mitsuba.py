"""Values, densities and parameters against Mitsuba 3.9.1."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.bsdf import reference
from tests.bsdf.lanes import DELTA, GLASS, IDEAL, KINDS, SMOOTH, directions, material, random_numbers, sampled, values_of
from tests.bsdf.reference import ROUGH_COAT
from tests.plugin.plugin_table import beyond_mitsuba
from tests.scenes.materials import MATERIALS, as_dict
from torch_radbp.bsdf.ior import CONDUCTORS, DIELECTRICS
from torch_radbp.tensors.vec import Vec3

COUNT = 1500
# Mitsuba's bump maps take heights over a surface, and not slopes: see `tests/peer` and `test_bumpmap`.
KNOWN = [name for name, description in MATERIALS.items() if description["type"] not in {"bumpmap", *beyond_mitsuba()}]
# Mitsuba computes in single precision; near the mirror direction a sharp lobe magnifies its rounding.
EVAL = 1e-3
# For Beckmann the density here is that of the samples, exactly; Mitsuba's has Walter's rational function, right to 0.35%.
DENSITY = {"beckmann": 3.6e-3, "ggx": 1e-3}


def ours(description: dict, wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bsdf = material(description)
    wi, wo = (Vec3.of(torch.as_tensor(np.asarray(w), dtype=torch.float64)) for w in (wi, wo))
    values = values_of(bsdf, wi.z)
    return tuple(result.detach().numpy() for result in (bsdf.kind().eval(values, wi, wo).stack(),
                                                        bsdf.kind().pdf(values, wi, wo)))


def assert_agree(description: dict, found, expected) -> None:
    (value, density), (their_value, their_density) = found, expected
    assert np.isfinite(their_value).all() and np.isfinite(their_density).all()
    # What is a millionth of the peak is below their rounding, or cut to zero.
    seen, likely = their_value.max(1) > 1e-6 * their_value.max(), their_density > 1e-6 * their_density.max()
    assert seen.sum() >= 3 and likely.sum() >= 3
    distribution = "ggx" if "principled" in repr(description) else description.get("distribution", "beckmann")
    coat = ROUGH_COAT if "roughplastic" in repr(description) else 0.0
    np.testing.assert_allclose(value[seen], their_value[seen], rtol=max(EVAL, coat), atol=1e-6 * their_value.max())
    if description["type"] == "roughdielectric" and not description.get("sample_visible", True):
        return  # of glass Mitsuba draws hidden normals from a wider distribution than that of the surface
    np.testing.assert_allclose(density[likely], their_density[likely],
                               rtol=max(DENSITY[distribution], coat))
    assert (value[~seen].max(initial=0) <= 2e-6 * their_value.max())
    assert (density[~likely].max(initial=0) <= 2e-6 * their_density.max())


@pytest.mark.parametrize("name", reference.MATERIALS)
def test_recorded_figures(name):
    pairs = [np.array([reference.unit(*angles) for angles in side]) for side in zip(*reference.PAIRS)]
    rows = reference.recorded()[name]
    assert_agree(reference.MATERIALS[name], ours(reference.MATERIALS[name], *pairs), (rows[:, :3], rows[:, 3]))


@pytest.mark.parametrize("name", [name for name in SMOOTH if name in KNOWN])
def test_eval_and_pdf_agree(name):
    pytest.importorskip("mitsuba")
    wi, wo = directions(COUNT, 1), directions(COUNT, 2)
    if MATERIALS[name]["type"] == "principled" and not KINDS[name].transmits:
        wi = wi._replace(z=wi.z.abs())  # behind, Mitsuba has a density, but neither values nor samples
    # Half of the pairs where samples go, which random pairs of a sharp lobe hardly meet.
    bsdf = material(MATERIALS[name])
    values = values_of(bsdf, wi.z)
    _, likely = sampled(bsdf.kind(), values, wi, random_numbers(COUNT))
    half = (torch.arange(COUNT) % 2 == 0) & (likely.z.abs() > 1e-3)
    wo = torch.where(half[:, None], likely.stack().detach(), wo.stack()).numpy()
    wi = wi.stack().numpy()
    assert_agree(MATERIALS[name], ours(MATERIALS[name], wi, wo), reference.by_mitsuba(MATERIALS[name], wi, wo))


# Mitsuba 3.9.1 adds the densities of smooth lobes to the chance of a delta lobe where a blend has both.
WEIGHED_ALIKE = [name for name in [*DELTA, *GLASS] if name in IDEAL or MATERIALS[name]["type"] != "blendbsdf"]


@pytest.mark.parametrize("name", WEIGHED_ALIKE)
def test_weights_of_a_sample_agree(mi, name):
    """The weight over the choice's probability, for what Mitsuba samples with the same number for the choice."""
    theirs, bsdf, context = mi.load_dict(as_dict(MATERIALS[name])), material(MATERIALS[name]), mi.BSDFContext()
    kind, wi, random = bsdf.kind(), directions(300), random_numbers(300)
    values = values_of(bsdf, wi.z)
    choice, wo = sampled(kind, values, wi, random)
    compared = 0
    for lane in range(300):
        si = mi.SurfaceInteraction3f()
        si.n, si.sh_frame, si.wi = [0, 0, 1], mi.Frame3f([0, 0, 1]), [float(c[lane]) for c in wi]
        choose, u, v = (float(number[lane]) for number in random)
        sample, weight = theirs.sample(context, si, choose, [u, v])
        if not choice.is_delta(kind)[lane]:
            # They map the numbers to other directions; given the direction, weights are those of `eval`.
            if max(weight) == 0 or abs(sample.wo[2]) < 1e-3:
                continue
            wo_lane = Vec3(*(torch.tensor([float(c)], dtype=torch.float64) for c in sample.wo))
            lane_values = tuple(Vec3(*(c[lane:lane + 1] for c in value)) for value in values)
            wi_lane = Vec3(*(c[lane:lane + 1] for c in wi))
            found = (kind.eval(lane_values, wi_lane, wo_lane) / kind.pdf(lane_values, wi_lane, wo_lane)).stack()[0]
            np.testing.assert_allclose(found.detach(), list(weight), rtol=8e-3, atol=1e-5)
        else:
            found = (kind.specular(values, wi, choice) / choice.probability).stack()[lane]
            if max(weight) > 0:
                np.testing.assert_allclose([float(c[lane]) for c in wo], list(sample.wo), atol=2e-4)
            np.testing.assert_allclose(found.detach(), list(weight), rtol=1e-4, atol=1e-6)
        compared += max(weight) > 0
    assert compared > 100


@pytest.mark.parametrize("name", KNOWN)
def test_parameters_have_the_names_that_mitsuba_gives_them(mi, name):
    theirs = mi.traverse(mi.load_dict(as_dict(MATERIALS[name])))
    theirs = {key: theirs[key] for key in theirs.keys() if not key.endswith("_sampling_rate")}  # attributes here
    bsdf = material(MATERIALS[name])
    own = dict(bsdf.named_parameters())
    # Factors that were not given exist here too, and can be optimised.
    assert set(theirs) <= set(own)
    not_given = {"specular_reflectance", "specular_transmittance"}
    assert {key.split(".")[-2] for key in set(own) - set(theirs)} <= not_given
    for key in theirs:
        np.testing.assert_allclose(own[key].detach(), np.array(theirs[key]).squeeze(), rtol=1e-5)


def test_all_metals_that_mitsuba_names_are_known(mi):
    files = (Path(mi.__file__).parent / "data" / "ior").glob("*.eta.spd")
    assert {file.name.removesuffix(".eta.spd") for file in files} == set(CONDUCTORS) and len(CONDUCTORS) > 50


def test_named_materials_have_the_indices_that_mitsuba_has(mi):
    for name, (eta, k) in CONDUCTORS.items():
        theirs = mi.traverse(mi.load_dict({"type": "conductor", "material": name}))
        np.testing.assert_allclose(eta, list(theirs["eta.value"]), rtol=1e-5)
        np.testing.assert_allclose(k, list(theirs["k.value"]), rtol=1e-5)
    for name, index in DIELECTRICS.items():
        theirs = mi.traverse(mi.load_dict({"type": "dielectric", "int_ior": name, "ext_ior": "vacuum"}))
        assert index == pytest.approx(theirs["eta"], rel=1e-6)
