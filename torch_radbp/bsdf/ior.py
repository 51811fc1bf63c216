"""Indices of refraction of named materials, and the attributes of plugins that give one.

All figures are those that Mitsuba 3.9.1 shows for the name, so that a scene gives the same image in both:

    mi.traverse(mi.load_dict({"type": "dielectric", "int_ior": name, "ext_ior": "vacuum"}))["eta"]
    mi.traverse(mi.load_dict({"type": "conductor", "material": name}))

Dielectrics have the index of visible light that tables of physical constants give. Conductors have measured spectra (such
as those of Palik 1985, "Handbook of Optical Constants of Solids") as `scalar_rgb` turns them into linear sRGB.
"""

from __future__ import annotations

from torch_radbp.plugin import BSDF, Texture, nearest, positive
from torch_radbp.texture.rgb import as_texture

DIELECTRICS = {
    "vacuum": 1.0, "helium": 1.000036, "hydrogen": 1.000132, "air": 1.000277, "carbon dioxide": 1.00045, "water": 1.333,
    "acetone": 1.36, "ethanol": 1.361, "carbon tetrachloride": 1.461, "glycerol": 1.4729, "benzene": 1.501,
    "silicone oil": 1.52045, "bromine": 1.661, "water ice": 1.31, "fused quartz": 1.458, "pyrex": 1.47,
    "acrylic glass": 1.49, "polypropylene": 1.49, "bk7": 1.5046, "sodium chloride": 1.544, "amber": 1.55, "pet": 1.575,
    "diamond": 2.419,
}

# eta and k in linear sRGB.
CONDUCTORS = {
    "a-C": ((2.944046, 2.227136, 1.968162), (0.8874649, 0.7992985, 0.81529)),
    "Ag": ((0.1552762, 0.116728, 0.1383876), (4.828354, 3.122222, 2.146901)),
    "Al": ((1.657501, 0.8804047, 0.5212445), (9.223811, 6.269502, 4.837004)),
    "Au": ((0.143036, 0.3753071, 1.442045), (3.982997, 2.385556, 1.603359)),
    "Be": ((4.185012, 3.185029, 2.784061), (3.835466, 3.010122, 2.868994)),
    "Cr": ((4.369668, 2.916505, 1.654905), (5.206547, 4.231306, 3.754699)),
    "Cu": ((0.2010055, 0.9237495, 1.102215), (3.913262, 2.453045, 2.14209)),
    "CuO": ((3.247541, 2.447805, 2.21022), (0.5210896, 0.5700307, 0.7221789)),
    "Hg": ((2.398939, 1.440028, 0.9095704), (6.327587, 4.371925, 3.421764)),
    "Ir": ((3.0863, 2.082191, 1.617915), (5.592153, 4.067088, 3.267312)),
    "K": ((0.06404319, 0.04640977, 0.03818491), (2.1042, 1.34894, 0.9131259)),
    "Li": ((0.2657909, 0.1956183, 0.2209486), (3.540155, 2.311123, 1.668607)),
    "Na_palik": ((0.06026936, 0.05614095, 0.06198843), (3.179273, 2.11249, 1.579041)),
    "Ni_palik": ((2.367305, 1.663373, 1.467078), (4.498812, 3.050153, 2.345439)),
    "Rh": ((2.585793, 1.860216, 1.554263), (6.78226, 4.702987, 3.976073)),
    "Se": ((4.058311, 2.842935, 2.820853), (0.7540495, 0.6384435, 0.5218076)),
    "Ta": ((2.062721, 2.392939, 2.627929), (2.40836, 1.741486, 1.947028)),
    "Te": ((7.390234, 4.482105, 2.637106), (3.256022, 3.527059, 3.292054)),
    "TiN": ((1.64845, 1.150516, 1.379823), (3.368328, 1.943498, 1.102068)),
    "VN": ((2.865602, 2.119189, 1.940091), (3.032243, 2.056116, 1.616306)),
    "W": ((4.370817, 3.300246, 2.998407), (3.500641, 2.604874, 2.273233)),
}


def index_of_refraction(name: str, value: float | str) -> float:
    """The index that the attribute `name` gives as a number or as the name of one of `DIELECTRICS`.

    Raises:
        ValueError: if the material is unknown, or the index is not greater than zero.
    """
    if isinstance(value, str):
        if value.lower() not in DIELECTRICS:
            raise ValueError(f"{name} {value!r} is not known; give a number, or one of these: {nearest(value, DIELECTRICS)}")
        return DIELECTRICS[value.lower()]
    return positive(name, value)


def complex_index(owner: BSDF, material: str, eta: Texture | float | None,
                  k: Texture | float | None) -> tuple[Texture, Texture]:
    """The textures eta and k of the conductor `owner`: those given, or those of a named metal; "none": a perfect mirror.

    Raises:
        ValueError: if the material is unknown or given beside eta or k, or if a value is negative.
    """
    named = material != "none"
    if named and (eta is not None or k is not None):
        raise ValueError(f"give either material or eta and k, got material {material!r} and "
                         f"{'eta' if eta is not None else 'k'}")
    if named and material not in CONDUCTORS:
        raise ValueError(f"material {material!r} is not known; give eta and k, or one of these: "
                         f"{nearest(material, (*CONDUCTORS, 'none'))}")
    if named:
        eta, k = CONDUCTORS[material]
    eta, k = 0.0 if eta is None else eta, 1.0 if k is None else k
    return as_texture(owner, "eta", eta), as_texture(owner, "k", k)
