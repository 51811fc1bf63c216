"""Our derivatives of materials, textures and lights against Mitsuba's, answer by answer, where nothing is sampled.

The references are stored (`mitsuba_derivatives`), so that Mitsuba is not needed here. The rows are what the code registers.
"""

from __future__ import annotations

from functools import cache
from unittest import mock

import numpy as np
import pytest

from tests.bsdf.lanes import MIXED
from tests.bsdf.reference import ROUGH_COAT
from tests.plugin.plugin_table import beyond_mitsuba
from tests.scenes.materials import MATERIALS
from tests.scenes.pairs import Pair, pairs_of, registered
from torch_radbp.bsdf import plastic
from torch_radbp.bsdf.microfacet import Beckmann
from torch_radbp.bsdf.rough_coat import TABLE
from torch_radbp.bsdf.roughplastic import RoughPlasticKind
from torch_radbp.plugin import REGISTRY

from .derivative_subjects import COLUMNS, SUBJECTS, WI, WO
from .mitsuba_derivatives import Reference, load_reference, reference
from .our_derivatives import Derivatives, derivatives, subject_of

CATEGORIES = ("bsdf", "emitter", "texture")
BEYOND = beyond_mitsuba() - {"rgb"}  # which is compared as colours of other plugins

# Mitsuba computes in single precision: right to 1e-5 of the largest derivative where terms cancel, and stored with 14 bits.
RELATIVE, OF_LARGEST = 1e-3, 2e-5
DIFFERENCES = 1e-3  # of the largest: rounding over a step of 0.004, and kinks that were just not found
ROUNDING = 1e-7  # of what is zero

# Mitsuba computes the sun's solid angle by 1 - cos(0.27 degrees) in single precision, which is 0.22 % too little, and so
# finds less radiance of a sun of another size; of the usual size that cancels, see tests/emitter/test_sunsky.py.
SUN = 3e-3

# What Mitsuba has otherwise, or not at all.
WIDER = "Mitsuba draws hidden normals of glass from a wider distribution than the surface has"
LEAST = "lobes are drawn here as if their weight were at least 0.02"
ADDED = "where a blend has both, Mitsuba adds the densities of smooth lobes to the chance of a delta lobe"
LEFT_OUT = {("hidden glass beckmann", "pdf"): WIDER,
            **{(f"{name} with a trace of all", "pdf"): LEAST for name in ("principled", "sheet")},
            **{(name, answer): ADDED for name in MIXED if MATERIALS[name]["type"] == "blendbsdf"
               for answer in ("weight", "direction")}}
NOT_THERE = ("specular_reflectance.value", "specular_transmittance.value")  # unless given, they are no parameters there
NO_ROW = {
    Pair("texture blackbody", "temperature"): "of the spectral modes: in RGB Mitsuba makes a colour of it at once",
    Pair("texture irregular", "values"): "the same",
    Pair("texture regular", "values"): "the same",
    Pair("texture volume", "volume"): "Mitsuba differentiates no volume on a surface; see tests/texture/test_volume.py",
    Pair("emitter directionalarea", "radiance"): "Mitsuba finds its light from its own side only; images: beams",
}


@cache
def stored(name: str) -> Reference:
    return load_reference(name)


def by_walter(facets: Beckmann, w):
    """What Mitsuba's density of visible Beckmann normals is divided by, with the rational function that also shadows."""
    return 1.0 / facets.masking(w)


def between_cosines(passes):
    """What a rough coat lets through, read as Mitsuba does: linear between `TABLE` cosines.

    Its slope by the direction jumps there, and is off by up to 1.4 % of the largest. That ours is right by roughness and
    index is in tests/bsdf/test_rough_coat.py.
    """

    def passes_by_table(kind: RoughPlasticKind, values, z):
        place = z * (TABLE - 1)
        lower = place.detach().floor().clamp(0, TABLE - 2)
        first, second = (passes(kind, values, cosine / (TABLE - 1)) for cosine in (lower, lower + 1))
        return first + (second - first) * (place - lower)

    return passes_by_table


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    """Our derivatives of a subject, with two approximations of Mitsuba's in the place of what is exact here, and with the
    lobes of smooth plastic drawn as rarely as there."""
    folder, by_table = tmp_path_factory.mktemp("files"), between_cosines(RoughPlasticKind.passes)

    @cache
    def found(name: str) -> Derivatives:
        with mock.patch.object(Beckmann, "projected_area", by_walter), mock.patch.object(
                RoughPlasticKind, "passes", by_table), mock.patch.object(plastic, "LEAST_CHANCE", 0.0):
            return derivatives(SUBJECTS[name], folder)

    return found


def tolerance(name: str, row: str, differences: bool, expected: np.ndarray) -> np.ndarray:
    """How far derivatives of one answer may be off."""
    largest, kind = abs(expected).max(), repr(SUBJECTS[name].description)
    if "roughplastic" in kind:
        return np.full_like(expected, ROUGH_COAT * largest)
    if "'sunsky'" in kind and row in ("lamp.sun_scale", "lamp.turbidity"):
        return np.full_like(expected, SUN * largest)
    if differences:
        return np.full_like(expected, DIFFERENCES * largest)
    return RELATIVE * abs(expected) + OF_LARGEST * largest


def compared(name: str, ours: Derivatives, factor: float = 1.0) -> dict[tuple[str, str], str]:
    """By row and answer, nothing if ours times a factor are Mitsuba's, else the worst pair; without those that are zero."""
    theirs, results = stored(name), {}
    for row, expected, differences in zip(theirs.names, theirs.derivatives, theirs.differences):
        first, found = 0, factor * ours.rows[row]
        for answer, width in COLUMNS[SUBJECTS[name].asked].items():
            there, columns = np.isfinite(expected[:, first]), slice(first, first + width)
            assert there.mean() > 2 / 3, f"{row} has too few places with a derivative"
            there &= ~(ours.dark & (answer == "pdf"))
            mine, wanted, first = found[there, columns], expected[there, columns], first + width
            if (name, answer) in LEFT_OUT or max(abs(mine).max(initial=0), abs(wanted).max(initial=0)) < ROUNDING:
                continue
            off = abs(mine - wanted) - tolerance(name, row, differences, wanted)
            worst = np.unravel_index(off.argmax(), off.shape)
            agrees = off[worst] <= 0
            results[row, answer] = "" if agrees else f"{mine[worst]:.7g} instead of {wanted[worst]:.7g}"
    return results


@pytest.mark.parametrize("name", SUBJECTS)
def test_derivatives_are_mitsubas(name, ours):
    theirs, found = stored(name).names, ours(name)
    assert set(theirs) == {row for row in found.rows if not row.endswith(NOT_THERE) or row in theirs}
    results = compared(name, found)
    assert results and all(np.isfinite(row).all() for row in found.rows.values())
    assert not {what: pair for what, pair in results.items() if pair}


@pytest.mark.parametrize("name", SUBJECTS)
def test_one_per_cent_is_noticed(name, ours):
    assert not {what for what, pair in compared(name, ours(name), 1.01).items() if not pair}


@pytest.fixture(scope="module")
def examined(ours, tmp_path_factory) -> set[Pair]:
    """What the rows move that makes a difference; directions under the names of the materials."""
    found, folder = set(), tmp_path_factory.mktemp("files")
    for name, subject in SUBJECTS.items():
        module = subject_of(subject, folder)
        for row, _ in compared(name, ours(name)):
            if row in (WI, WO):
                found.add(Pair(f"bsdf {module.bsdf.type}", row))
            elif subject.asked == "bsdf":
                found |= pairs_of(module, f"bsdf.{row}")
            else:
                found |= pairs_of(module.scene, row)
    return found


@pytest.mark.parametrize("pair", sorted(
    pair for pair in registered() if pair.plugin.startswith(CATEGORIES) and not BEYOND & set(pair.plugin.split())), ids=str)
def test_a_row_moves_every_parameter(pair, examined):
    assert (pair in examined) != (pair in NO_ROW), f"derivative_subjects.py must have {pair}, or NO_ROW a reason"


@pytest.mark.parametrize("kind", [kind for kind in REGISTRY["bsdf"] if kind not in {"null", *BEYOND}])
def test_a_row_moves_the_directions_of_every_material(kind, examined):
    assert Pair(f"bsdf {kind}", WI) in examined or kind == "diffuse"  # which looks the same from everywhere
    assert Pair(f"bsdf {kind}", WO) in examined or kind in ("conductor", "dielectric", "thindielectric")  # scatter into one


@pytest.mark.parametrize("name", ["plastic", "light point"])
def test_what_is_stored_is_what_mitsuba_says_now(name):
    pytest.importorskip("mitsuba")
    try:
        found = reference(SUBJECTS[name])
    except ImportError as error:
        pytest.skip(f"Mitsuba's LLVM variant: {error}")
    assert found.names == stored(name).names
    for now, then in zip(found.derivatives, stored(name).derivatives):
        np.testing.assert_allclose(now, then, rtol=1e-3, atol=DIFFERENCES * np.nanmax(abs(then)))
