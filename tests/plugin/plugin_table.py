"""The table of plugins in `docs/what_there_is.md`."""

from __future__ import annotations

import re
from pathlib import Path

TABLE = Path(__file__).parents[2] / "docs" / "what_there_is.md"
CATEGORIES = {  # by the first cell of a row: ours, Mitsuba's
    "BSDFs": ("bsdf", "BSDF"), "Emitters": ("emitter", "Emitter"), "Shapes": ("shape", "Shape"),
    "Textures and spectra": ("texture", "Texture"), "Sensors": ("sensor", "Sensor"), "Films": ("film", "Film"),
    "Filters": ("rfilter", "ReconstructionFilter"), "Samplers": ("sampler", "Sampler"),
    "Integrators": ("integrator", "Integrator"), "Media": ("medium", "Medium"),
    "Phase functions": ("phase", "PhaseFunction"), "Volumes": ("volume", "Volume"),
}


def table() -> dict[str, list[set[str]]]:
    """By category the names that are supported, those beyond Mitsuba's, and those that are not supported."""
    rows = re.findall(rf"^\| ({'|'.join(CATEGORIES)}) \|(.*)\|$", TABLE.read_text(), re.MULTILINE)
    found = {}
    for category, rest in rows:
        cells = rest.split("|")
        assert len(cells) == 3, f"the row {category} must have 4 cells"
        names = [name for cell in cells for chunk in re.findall(r"`([^`]*)`", cell) for name in chunk.split()]
        assert len(names) == len(set(names)), f"{category}: a plugin is listed twice"
        found[category] = [{name for chunk in re.findall(r"`([^`]*)`", cell) for name in chunk.split()} for cell in cells]
    return found


def beyond_mitsuba() -> set[str]:
    """The plugins that Mitsuba does not have, so that nothing of hers is compared with them."""
    return set().union(*(beyond for _, beyond, _ in table().values()))
