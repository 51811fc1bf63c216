"""Reads grids of float32 from NanoVDB files as dense values; strictly.

A file has segments: a header, metadata and the name of each grid, then the grids, zipped or not. A grid is a tree. Its root
lists nodes of 32^3 children of 16^3 children, the leaves, of 8^3 values; in the place of a child a value may stand for all
of it. The map from indices to the world is an affine one. Little-endian.

Reference: Museth 2021, "NanoVDB: A GPU-Friendly and Portable VDB Data Structure For Real-Time Rendering And Simulation", and
PNanoVDB.h of NanoVDB, version 32, which has the offsets.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from torch_radbp.formats.files import opened

FILE_MAGIC, GRID_MAGIC = (b"NanoVDB0", b"NanoVDB2"), (b"NanoVDB0", b"NanoVDB1")
HEADER, MAJOR, UNZIPPED, ZIPPED = struct.Struct("<8sIHH"), 32, 0, 1
NAME_SIZE, METADATA = 136, 176  # where the metadata of a grid has the size of its name, and their own size
MAP, CLASS, TREE, ROOT_TILES = 296, 632, 672, 24  # offsets in a grid; in its root
LEVEL_SET = 1
LARGEST = 1 << 30  # values of a dense grid
CONVERT = "convert it by `nanovdb_convert smoke.vdb smoke.nvdb`, a program of OpenVDB"


class GridLayout(NamedTuple):
    """The sizes of a tree's parts that depend on the type of its values, in bytes."""

    channels: int
    root_size: int
    stride: int  # between the entries of inner nodes
    leaf: int  # offset of the values


LAYOUTS = {1: GridLayout(1, 64, 8, 96), 6: GridLayout(3, 96, 16, 128)}  # by the number of the type


class TreeLevel(NamedTuple):
    """The inner nodes of one level of a tree."""

    side: int  # children along an axis
    reach: int  # indices along an axis of a child
    mask: int  # offset of the bits that tell where there are children
    table: int  # offset of their entries


LEVELS = TreeLevel(32, 128, 4128, 8256), TreeLevel(16, 8, 544, 1088)


class DenseGrid(NamedTuple):
    """The values of a grid, and its transform to the world."""

    values: np.ndarray  # (Z, Y, X, C) float32, with a layer of background around those that are set
    to_world: np.ndarray  # (4, 4) float64, from the unit cube that they fill


def read_nanovdb(path: str | os.PathLike, name: str | None = None) -> DenseGrid:
    """Reads the grid called `name` from a file; None: the only one.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        ValueError: names the file, if it is malformed, cut short, or has no such grid of a type that is read.
    """
    place = os.fspath(path)
    with opened(path) as file:
        data = file.read()
    try:
        grids = dict(grids_in(data))
        if name is None and len(grids) != 1 or name is not None and name not in grids:
            raise ValueError(f"grid_name must be one of {', '.join(map(repr, grids))}, got {name!r}")
        return dense(np.frombuffer(grids[name] if name is not None else next(iter(grids.values())), np.uint8))
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None
    except (struct.error, zlib.error, IndexError, OverflowError):
        raise ValueError(f"{place}: it is broken, or cut short at {len(data)} bytes") from None


def grids_in(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Yields the grids of a NanoVDB file, decompressed, with their names."""
    at = 0
    while at < len(data) or not at:
        magic, version, count, codec = HEADER.unpack_from(data, at)
        if magic not in FILE_MAGIC:
            raise ValueError(f"a NanoVDB file begins with {FILE_MAGIC[-1]!r}, got {magic!r}")
        if version >> 21 != MAJOR:
            raise ValueError(f"the major version must be {MAJOR}, got {version >> 21}; {CONVERT}")
        if codec not in (UNZIPPED, ZIPPED):
            raise ValueError(f"its grids must be zipped, or not compressed, got codec {codec} (2: BLOSC); {CONVERT}")
        at, sizes = at + HEADER.size, []
        for _ in range(count):
            size, = struct.unpack_from("<I", data, at + NAME_SIZE)
            grid, stored = struct.unpack_from("<QQ", data, at)
            name = data[at + METADATA:at + METADATA + size].split(b"\0")[0].decode("utf-8", "replace")
            sizes.append((name, grid, stored))
            at += METADATA + size
        for name, grid, stored in sizes:
            part = data[at:at + stored] if codec == UNZIPPED else unzipped(data, at, grid)
            at += stored if codec == UNZIPPED else 8 + struct.unpack_from("<Q", data, at)[0]
            if len(part) != grid:
                raise ValueError(f"grid {name!r} needs {grid} bytes, got {len(part)}; is the file cut short?")
            yield name, part


def unzipped(data: bytes, at: int, size: int) -> bytes:
    """Decompresses the grid, `size` bytes long, whose compressed length and bytes stand at byte `at`."""
    stored, = struct.unpack_from("<Q", data, at)
    return zlib.decompressobj().decompress(data[at + 8:at + 8 + stored], min(max(size, 1), 1 << 40))


def dense(grid: np.ndarray) -> DenseGrid:
    """Reads a grid of a NanoVDB file, given as its bytes, (N,) uint8, into an array of all values in its box."""
    magic, (kind, of_type) = grid[:8].tobytes(), struct.unpack_from("<II", grid, CLASS)
    if magic not in GRID_MAGIC:
        raise ValueError(f"a grid begins with {GRID_MAGIC[-1]!r}, got {magic!r}")
    if of_type not in LAYOUTS or kind == LEVEL_SET:
        raise ValueError(f"its values must be float32, one or three at a point, and no distances to a surface, got type "
                         f"{of_type}, class {kind}")
    layout, root = LAYOUTS[of_type], TREE + struct.unpack_from("<q", grid, TREE + 24)[0]
    least, most = np.array(struct.unpack_from("<6i", grid, root), np.int64).reshape(2, 3)
    if (most < least).any():
        raise ValueError("no value of the grid is set")
    # Blocks of 8^3 values around those that are set, and one more.
    first = (least - 1) >> 3
    blocks = ((most + 1) >> 3) - first + 1
    if int(blocks.prod(dtype=object)) * 512 * layout.channels > LARGEST:
        raise ValueError(f"its values are set in a box of {' x '.join(map(str, most - least + 1))} cells, of which at most "
                         f"{LARGEST:,} values are read; resample it before")
    background = np.array(struct.unpack_from(f"<{layout.channels}f", grid, root + 28), np.float32)
    values = np.empty((*blocks, 8, 8, 8, layout.channels), np.float32)
    values[:] = background
    fill(values, grid, layout, root, first, background)
    values = values.transpose(2, 5, 1, 4, 0, 3, 6).reshape(*(8 * blocks[::-1]), layout.channels)
    low, high = least - 1 - 8 * first, most + 2 - 8 * first
    values = values[low[2]:high[2], low[1]:high[1], low[0]:high[0]]
    # A value stands at its index, and in the middle of its cell.
    to_world, into_indices = np.eye(4), np.diag([*(high - low), 1.0])
    into_indices[:3, 3] = least - 1.5
    to_world[:3, :3] = np.reshape(struct.unpack_from("<9d", grid, MAP + 88), (3, 3))
    to_world[:3, 3] = struct.unpack_from("<3d", grid, MAP + 232)
    return DenseGrid(np.ascontiguousarray(values), to_world @ into_indices)


def fill(values: np.ndarray, grid: np.ndarray, layout: GridLayout, root: int, first: np.ndarray,
         background: np.ndarray) -> None:
    """Writes the values of a tree, without the background, into blocks of 8^3, (X, Y, Z, 8, 8, 8, C), from block `first`
    on."""
    count, = struct.unpack_from("<I", grid, root + ROOT_TILES)
    tiles = root + layout.root_size + 32 * np.arange(min(count, len(grid)))  # else it is broken
    keys, children = numbers_at(grid, tiles, "<u8", 1)[:, 0], numbers_at(grid, tiles + 8, "<i8", 1)[:, 0]
    origins = np.stack([keys >> 42, keys >> 21, keys], 1) & 0x1FFFFF
    origins = (origins.astype(np.int64) << 44 >> 32)  # of 20 bits, with a sign
    nodes, origins = root + children[children != 0], origins[children != 0]
    for side, reach, mask, table in LEVELS:
        bits = np.unpackbits(numbers_at(grid, nodes + mask, "u1", side**3 // 8), axis=1, bitorder="little").astype(bool)
        inside = np.stack(np.unravel_index(np.arange(side**3), (side,) * 3), 1) * reach
        entries = (nodes + table)[:, None] + layout.stride * np.arange(side**3)
        places = origins[:, None] + inside
        tiles = numbers_at(grid, entries[~bits], "<f4", layout.channels)
        set_apart = (tiles != background).any(1)
        for tile, place in zip(tiles[set_apart], places[~bits][set_apart]):
            low, high = (np.maximum(end // 8 - first, 0) for end in (place, place + reach))
            values[low[0]:high[0], low[1]:high[1], low[2]:high[2]] = tile
        nodes = (nodes[:, None] + np.zeros(side**3, np.int64))[bits] + numbers_at(grid, entries[bits], "<i8", 1)[:, 0]
        origins = places[bits]
    block = origins // 8 - first
    inside = ((block >= 0) & (block < values.shape[:3])).all(1)  # others have no value that is set
    found = numbers_at(grid, nodes[inside] + layout.leaf, "<f4", 512 * layout.channels)
    values[tuple(block[inside].T)] = found.reshape(-1, 8, 8, 8, layout.channels)


def numbers_at(grid: np.ndarray, at: np.ndarray, kind: str, count: int) -> np.ndarray:
    """(N, count) numbers of the dtype `kind`, read from byte offsets `at`, (N,)."""
    size = np.dtype(kind).itemsize
    if at.size and not (0 <= at.min() and at.max() + size * count <= len(grid)) or (at % size).any():
        raise IndexError
    whole = np.frombuffer(grid, kind, len(grid) // size)
    return whole[at[:, None] // size + np.arange(count)]
