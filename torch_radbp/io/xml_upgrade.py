"""Upgrades scenes for Mitsuba before version 2 to the attribute names of Mitsuba 3.

    <texture type="bitmap" name="diffuseReflectance">      <texture type="bitmap" name="reflectance">
        <float name="uscale" value="2"/>                       <transform name="to_uv"><scale x="2" y="1"/></transform>
    </texture>                                             </texture>
"""

from __future__ import annotations

import re

from torch_radbp.io.xml import Element

# In the order in which they are applied.
PLACEMENT = {"uoffset": ("translate", "x"), "voffset": ("translate", "y"),
             "uscale": ("scale", "x"), "vscale": ("scale", "y")}
TAGS = {"lookAt": "lookat"}
REFLECTANCE = {"diffuse_reflectance": "reflectance"}  # of a diffuse BSDF, where it was another word for the same


def upgraded(element: Element) -> Element:
    """Renames all attributes in an element to Mitsuba 3's; ids, types and values stay as they are."""
    attributes = dict(element.attributes)
    if "name" in attributes and element.tag != "default":
        attributes["name"] = snake_case(attributes["name"])
    children = [upgraded(child) for child in element.children]
    if element.tag == "bsdf" and attributes.get("type") == "diffuse":
        children = [child._replace(attributes={**child.attributes, "name": REFLECTANCE.get(name, name)})
                    if (name := child.attributes.get("name")) else child for child in children]
    if element.tag == "texture":
        children = with_placement(children)
    return element._replace(tag=TAGS.get(element.tag, element.tag), attributes=attributes, children=children)


def snake_case(name: str) -> str:
    """Converts a name to snake case: to_world for toWorld, int_ior for intIOR."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def with_placement(children: list[Element]) -> list[Element]:
    """Replaces the numbers that shift and scale a texture by one `to_uv` transform."""
    numbers = {child.attributes["name"]: child for child in children if child.attributes.get("name") in PLACEMENT}
    if not numbers:
        return children
    operations = [numbers[name]._replace(tag=tag, attributes={axis: numbers[name].attributes.get("value", "")})
                  for name, (tag, axis) in PLACEMENT.items() if name in numbers]
    first = next(iter(numbers.values()))
    transform = first._replace(tag="transform", attributes={"name": "to_uv"}, children=operations)
    return [*(child for child in children if child.attributes.get("name") not in PLACEMENT), transform]
