"""Mutations of files, each a function of a random generator: of bytes, of words and numbers, and of structure."""

from __future__ import annotations

import random
import re
import struct
import zlib
from collections.abc import Callable
from xml.etree import ElementTree

from tests.fuzz.json_mutation import of_checkpoint, of_glb, of_json

NUMBERS = ["0", "-0", "1", "-1", "2", "0.5", "1e-46", "1e-30", "1e-8", "1e8", "1e20", "3e38", "1e39", "1e308", "1e309",
           "nan", "inf", "-inf", "255", "256", "65536", "2147483647", "2147483648", "4294967296", "18446744073709551616",
           "1e", "-", "0x10", "1_0", "1,5", "1.", ".5", "00", "9" * 32, "0.30000000000000004441", "180", "-90"]
TEXTS = ["", " ", "$", "$x", "..", "/", "a" * 300, "\u00e9\u4e16", "true", "none", "0 0 0", "1, 2, 3", "rectangle", "scene",
         "&amp;", "*", "\\", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"]
BYTES = [0, 1, 9, 10, 13, 32, 34, 45, 47, 48, 57, 60, 62, 127, 128, 255]
WORD = re.compile(r"[A-Za-z_]+|[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?|\s+|.", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
Mutation = Callable[[random.Random, bytes, list[bytes]], bytes]


def mutate(family: str, source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """A mutant of a file: one to four mutations of the kinds that suit its family.

    Args:
        family: such as "xml".
        source: of random numbers.
        content: the file.
        others: files of the same family, for pieces to paste.
    """
    for _ in range(1 + min(int(source.expovariate(1.3)), 3)):
        try:
            content = source.choice(MUTATIONS[family])(source, content, others)
        except (ElementTree.ParseError, struct.error, LookupError, ValueError, TypeError, AttributeError, OverflowError):
            content = of_bytes(source, content, others)  # what an earlier mutation broke has no structure
    return content


def of_bytes(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Changes, removes, repeats or inserts a few bytes, or cuts the file short."""
    start = source.randrange(len(content) + 1)
    if source.random() < 0.3:  # headers are where the decisions are
        start = min(start, source.randrange(64))
    stop = min(len(content), start + 1 + int(source.expovariate(0.2)))
    match source.randrange(6):
        case 0:
            return content[:start] + bytes([source.choice(BYTES)]) + content[start + 1:]
        case 1:
            flipped = bytes(byte ^ (1 << source.randrange(8)) for byte in content[start:start + 1])
            return content[:start] + flipped + content[start + 1:]
        case 2:
            return content[:start] + content[stop:]
        case 3:
            return content[:stop] + content[start:stop] * source.choice((1, 2, 50)) + content[stop:]
        case 4:
            other = source.choice(others)
            cut = source.randrange(len(other) + 1)
            return content[:start] + other[cut:cut + (stop - start)] + content[start:]
    return content[:start]


def of_words(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Changes, removes, repeats or swaps words and numbers of a text."""
    words = WORD.findall(content.decode("utf-8", "surrogateescape"))
    solid = [index for index, word in enumerate(words) if not word.isspace()]
    index, other = source.choice(solid), source.choice(solid)
    match source.randrange(5):
        case 0:
            numeric = [index for index in solid if words[index][-1].isdigit()]
            words[source.choice(numeric or solid)] = source.choice(NUMBERS)
        case 1:
            words[index] = ""
        case 2:
            words[index] += source.choice(["", " "]) + words[index]
        case 3:
            words[index], words[other] = words[other], words[index]
        case 4:
            foreign = WORD.findall(source.choice(others).decode("utf-8", "surrogateescape"))
            words[index] = source.choice(foreign)
    return "".join(words).encode("utf-8", "surrogateescape")


def of_values(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Scales, moves, negates or swaps numbers of a text, so that most mutants still load and are rendered."""
    text = content.decode("utf-8", "surrogateescape")
    found = list(NUMBER.finditer(text))
    for _ in range(source.choice((1, 1, 3, 10))):
        match = source.choice(found)
        number = float(match[0])
        changed = source.choice((number * 10 ** source.uniform(-2, 2), number * 10 ** source.uniform(-40, 40), -number,
                                 number + source.gauss(0, 1), float(source.choice(found)[0]), 0.0, 1.0, round(number)))
        word = str(int(changed)) if "." not in match[0] and abs(changed) < 1e18 else repr(changed)
        text = text[:match.start()] + word + text[match.end():]
        found = list(NUMBER.finditer(text))
    return text.encode("utf-8", "surrogateescape")


def of_lines(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Removes, repeats, swaps, joins or pastes lines."""
    lines = content.split(b"\n")
    index, other = source.randrange(len(lines)), source.randrange(len(lines))
    match source.randrange(5):
        case 0:
            del lines[index]
        case 1:
            lines.insert(other, lines[index])
        case 2:
            lines[index], lines[other] = lines[other], lines[index]
        case 3:
            lines[index:index + 2] = [b" ".join(lines[index:index + 2])]
        case 4:
            lines.insert(index, source.choice(source.choice(others).split(b"\n")))
    return b"\n".join(lines)


def of_xml(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Removes, repeats, moves, renames or pastes elements, and changes their attributes."""
    root = ElementTree.fromstring(content)
    parents = {child: parent for parent in root.iter() for child in parent}
    element = source.choice(list(parents) or [root])
    foreign = list(ElementTree.fromstring(source.choice(others)).iter())
    pool = foreign + list(root.iter())
    match source.randrange(8):
        case 0 if element in parents:
            parents[element].remove(element)
        case 1 if element in parents:
            parents[element].append(element)
        case 2:
            target = source.choice(list(root.iter()))
            if element in parents and target not in element.iter():
                parents[element].remove(element)
                target.insert(source.randrange(len(target) + 1), element)
        case 3:
            element.append(source.choice(foreign))
        case 4:
            element.tag = source.choice(pool).tag
        case 5 if element.attrib:
            del element.attrib[source.choice(sorted(element.attrib))]
        case 6:
            name = source.choice(sorted({name for each in pool for name in each.attrib}))
            element.set(name, source.choice([*NUMBERS, *TEXTS]))
        case 7 if element.attrib:
            name = source.choice(sorted(element.attrib))
            element.set(name, source.choice([each.get(name) for each in pool if name in each.attrib]))
    return ElementTree.tostring(root, encoding="utf-8")


def of_header(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Changes words or lines of a PLY file's header and leaves the tables as they are."""
    end = content.find(b"end_header\n") + 11
    change = source.choice((of_words, of_lines))
    return change(source, content[:max(end, 20)], others) + content[max(end, 20):]


def of_chunks(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Changes, removes, repeats or swaps chunks of a PNG file, with check sums that are right."""
    chunks, offset = [], 8
    while offset < len(content):
        length, = struct.unpack_from(">I", content, offset)
        if length > len(content):
            raise IndexError("broken chunk")
        chunks.append((content[offset + 4:offset + 8], content[offset + 8:offset + 8 + length]))
        offset += length + 12
    if not chunks:
        raise IndexError("no chunks")
    index, other = source.randrange(len(chunks)), source.randrange(len(chunks))
    match source.randrange(4):
        case 0:
            kind, data = chunks[index]
            chunks[index] = kind, of_bytes(source, data, [data])
        case 1:
            del chunks[index]
        case 2:
            chunks.insert(other, chunks[index])
        case 3:
            chunks[index], chunks[other] = chunks[other], chunks[index]
    return content[:8] + b"".join(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
                                  for kind, data in chunks)


def of_inflated(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """The first mesh of a serialized file with bytes of what is compressed in it changed, if it can be inflated still."""
    inflater = zlib.decompressobj()
    try:
        inflated = inflater.decompress(content[4:])
    except zlib.error:
        return of_bytes(source, content, others)
    return content[:4] + zlib.compress(of_bytes(source, inflated, [inflated])) + inflater.unused_data


def of_fields(source: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Overwrites four or eight bytes at a multiple of four by a number that no one expects."""
    layout, value = source.choice(FIELDS)
    start = 4 * source.randrange(len(content) // 4)
    return content[:start] + struct.pack(layout, value) + content[start + struct.calcsize(layout):]


FIELDS = [("<I", 0), ("<I", 255), ("<i", -1), ("<Q", 0), ("<Q", 2**31), ("<Q", 2**63), ("<q", -1), ("<d", float("nan")),
          ("<d", float("inf")), ("<d", 1e300), ("<d", -1.0), ("<d", 1e-300), ("<d", 1e12)]
MUTATIONS: dict[str, list[Mutation]] = {
    "xml": [of_values, of_values, of_values, of_xml, of_xml, of_words, of_bytes],
    "obj": [of_values, of_values, of_words, of_lines, of_bytes],
    "ply": [of_values, of_words, of_lines, of_header, of_header, of_bytes],
    **{name: [of_bytes] for name in ("vol", "exr", "bmp", "tga", "hdr", "pfm", "webp")},
    "tif": [of_bytes, of_bytes, of_fields],
    "png": [of_chunks, of_bytes],
    "serialized": [of_inflated, of_inflated, of_bytes],
    "toml": [of_values, of_values, of_words, of_lines, of_bytes],
    "checkpoint": [of_checkpoint, of_checkpoint, of_checkpoint, of_bytes],
    "gltf": [of_values, of_values, of_json, of_json, of_words, of_bytes],
    "glb": [of_glb, of_glb, of_bytes],
    "colmap_binary": [of_fields, of_fields, of_bytes],
    "colmap": [of_values, of_values, of_words, of_lines, of_bytes],
    "nerf": [of_values, of_values, of_json, of_json, of_words, of_bytes],
}
