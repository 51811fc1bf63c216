"""The AOVs by their names in Mitsuba's `aov` and `moment` integrators."""

from __future__ import annotations

from collections.abc import Iterable

from torch_radbp.plugin import nearest

# By name, with the letters of the channels in the names of a file's channels.
OF_SURFACES = {"depth": "T", "position": "XYZ", "uv": "UV", "geo_normal": "XYZ", "sh_normal": "XYZ", "dp_du": "XYZ",
               "dp_dv": "XYZ", "prim_index": "I", "shape_index": "I"}
OF_MATERIALS = {"albedo": "RGB"}
OF_PATHS = {"xyz": "XYZ", "alpha": "A", "hit": "A"}
QUANTITIES = {**OF_SURFACES, **OF_MATERIALS, **OF_PATHS}
UNDIFFERENTIATED = ("xyz", "prim_index", "shape_index")  # have no derivatives; alpha and hit only at edges
TURNING = ("albedo", "alpha", "hit")  # may differ between the two sides of a surface
SQUARED = "m2_"  # the name of a quantity's second moment begins with it


def plain(name: str) -> str:
    """The quantity without the prefix of second moments: "depth" for "depth" and for "m2_depth"."""
    return name.removeprefix(SQUARED)


def channel_names(name: str, quantity: str) -> list[str]:
    """The channel names of an AOV in a file, as in Mitsuba: "nn.X", "nn.Y" and "nn.Z" for the normals "nn"."""
    return [f"{name}.{letter}" for letter in QUANTITIES[plain(quantity)]]


def alpha_of_surroundings(names: Iterable[str]) -> UserWarning | None:
    """The warning that `alpha` is 1 everywhere because an environment is visible; None unless `alpha` is among the names."""
    if "alpha" not in map(plain, names):
        return None
    return UserWarning("the quantity 'alpha' is 1 everywhere, because an emitter surrounds the scene and counts as seen: as "
                       "a mask of the shapes take 'hit', or hide_emitters=True")


def checked_names(names: Iterable[str]) -> tuple[str, ...]:
    """Checks the names of AOVs, and drops duplicates.

    Raises:
        ValueError: if one is not known, or there is none.
        TypeError: if they are not strings in a sequence.
    """
    names = names if isinstance(names, str) else tuple(names)
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"aovs must be a sequence of names such as [\"depth\", \"sh_normal\"], got {names!r}")
    if not names:
        raise ValueError(f"aovs must name at least one quantity, got none; known: {', '.join(sorted(QUANTITIES))}")
    for name in names:
        if plain(name) not in QUANTITIES:
            raise ValueError(f"aovs: the quantity {name!r} is not known, nor is its mean square, m2_...; "
                             f"{nearest(name, QUANTITIES)}")
    return tuple(dict.fromkeys(names))
