"""Reads the header of a PLY file: which tables follow, and their format."""

from __future__ import annotations

import re
from typing import BinaryIO, NamedTuple

from torch_radbp.plugin import nearest

TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
         "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
         "double": "f8", "float64": "f8"}
BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_LINE = 4096
ROWS = re.compile(r"(\d{1,12})(\.0*)?")


class Property(NamedTuple):
    """A column of a table; a column of lists if `count` is given."""

    name: str
    kind: str  # dtype in numpy's notation, without byte order
    count: str | None  # dtype of the length before a list


class PLYElement(NamedTuple):
    """A table of a PLY file ("element")."""

    name: str
    rows: int
    properties: list[Property]


class Header(NamedTuple):
    """The header of a PLY file."""

    order: str  # "" for ascii, "<" or ">"
    elements: list[PLYElement]
    lines: int  # number of its lines


def read_header(file: BinaryIO, place: str) -> Header:
    """Reads the header; the file is left at the start of the first table.

    Raises:
        ValueError: names file and line of what is malformed, given twice or not supported.
    """
    order, elements, number = None, [], 1
    first = file.readline(LONGEST_LINE)
    if first.rstrip() != b"ply":
        raise ValueError(f"{place}, line 1: a PLY file begins with a line \"ply\", got {first[:20]!r}")
    while True:
        number += 1
        text = file.readline(LONGEST_LINE)
        words = text.decode("utf-8", "backslashreplace").split()
        if not text:
            raise ValueError(f"{place}, line {number}: the header is cut short, it has no line \"end_header\"")
        try:
            if words[:1] == ["end_header"]:
                break
            if words[:1] == ["format"] and order is None:
                order = _byte_order(words)
            elif words[:1] == ["element"]:
                elements.append(_element(words, elements))
            elif words[:1] == ["property"]:
                _add_property(words, elements)
            elif words[:1] not in ([], ["comment"], ["obj_info"]):
                raise ValueError(f"{text[:40]!r} is not a line of a header; expected format (once), comment, element, "
                                 "property or end_header")
        except ValueError as error:
            raise ValueError(f"{place}, line {number}: {error}") from None
    if order is None:
        raise ValueError(f"{place}, line {number}: the header has no line \"format ascii 1.0\" or the like")
    for element in elements:
        if element.rows > 0 and not element.properties:
            raise ValueError(f"{place}: the element {element.name!r} has {element.rows} rows and no properties")
    return Header(order, elements, number)


def _byte_order(words: list[str]) -> str:
    if len(words) != 3 or words[1] not in BYTE_ORDERS or words[2] != "1.0":
        raise ValueError(f"the format must be {', '.join(BYTE_ORDERS)} and its version 1.0, got {' '.join(words)!r}")
    return BYTE_ORDERS[words[1]]


def _element(words: list[str], before: list[PLYElement]) -> PLYElement:
    rows = ROWS.fullmatch(words[2]) if len(words) == 3 else None
    if rows is None:
        raise ValueError(f"expected \"element name rows\", got {' '.join(words)!r}")
    if words[1] in [element.name for element in before]:
        raise ValueError(f"the element {words[1]!r} is given twice")
    return PLYElement(words[1], int(rows[1]), [])


def _add_property(words: list[str], elements: list[PLYElement]) -> None:
    is_list = words[1:2] == ["list"]
    if not elements:
        raise ValueError("a property must follow after the element that it belongs to")
    if len(words) != (5 if is_list else 3):
        raise ValueError(f"expected \"property type name\" or \"property list type type name\", got {' '.join(words)!r}")
    *types, name = words[2 if is_list else 1:]
    for kind in types:
        if kind not in TYPES:
            raise ValueError(f"{kind!r} is not a type of PLY; {nearest(kind, TYPES)}")
    if name in [earlier.name for earlier in elements[-1].properties]:
        raise ValueError(f"the property {name!r} of element {elements[-1].name!r} is given twice")
    elements[-1].properties.append(Property(name, TYPES[types[-1]], TYPES[types[0]] if is_list else None))
