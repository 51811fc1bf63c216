"""Mutations of the structure of JSON, alone or inside of a GLB file."""

from __future__ import annotations

import copy
import json
import random
import struct
from collections.abc import Iterator
from typing import Any

from torch_radbp.training.recovery.checkpoint import HEADER

VALUES: list[Any] = [0, 1, -1, 2, 3, 7, 255, 2**16, 2**31, 2**32, 2**53, 10**400, 0.5, 1e-30, 1e30, 1e300, True, False,
                     None, "", "x", "\u00e9", "../x", [], {}, [0], [1, 2, 3], [0.0] * 16, {"index": 0}, "VEC3", 5123, 5126]


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """All (container, key) pairs of a document."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in list(entries):
        yield value, key
        yield from places(inner)


def of_json(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Removes, repeats, exchanges, renames or replaces entries of a document."""
    document = json.loads(content)
    found = list(places(document))
    holder, key = source.choice(found)
    other, place = source.choice(found)
    match source.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder.insert(source.randrange(len(holder) + 1), copy.deepcopy(holder[key]))
        case 2:
            holder[key], other[place] = copy.deepcopy(other[place]), copy.deepcopy(holder[key])
        case 3 if isinstance(holder, dict):
            holder[source.choice([place for each, place in found if isinstance(each, dict)])] = holder.pop(key)
        case 4:
            holder[key] = copy.deepcopy(other[place])
        case _:
            holder[key] = source.choice(VALUES)
    return json.dumps(document).encode()


def of_glb(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """The same of the document in a GLB file, whose lengths are made to fit."""
    size, = struct.unpack_from("<I", content, 12)
    text = of_json(source, content[20:20 + size], others)
    text += b" " * (-len(text) % 4)
    rest = content[20 + size:]
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def of_checkpoint(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """The same of one of the two documents in a checkpoint: the table of its tensors, and the numbers beside them."""
    size, = struct.unpack_from("<Q", content)
    text = content[8:8 + size]
    table = json.loads(text)
    if source.random() < 0.7:
        table["__metadata__"][HEADER] = of_json(source, table["__metadata__"][HEADER].encode(), others).decode()
        text = json.dumps(table).encode()
    else:
        text = of_json(source, text, others)
    return struct.pack("<Q", len(text)) + text + content[8 + size:]
