"""PNG and TIFF files that Pillow cannot write, put together by hand: 16 bits of each number, with alpha.

References: W3C 2003, "Portable Network Graphics (PNG) Specification", sections 5 and 11; Adobe 1992, "TIFF, Revision 6.0",
section 8.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

PNG_COLOURS = {1: 0, 2: 4, 3: 2, 4: 6}  # colour types by the number of channels
TAGS = ("ImageWidth", "ImageLength", "BitsPerSample", "Compression", "PhotometricInterpretation", "StripOffsets",
        "Orientation", "SamplesPerPixel", "RowsPerStrip", "StripByteCounts", "PlanarConfiguration", "ExtraSamples")
NUMBERS = dict(zip(TAGS, (256, 257, 258, 259, 262, 273, 274, 277, 278, 279, 284, 338)))


def png_of(words: np.ndarray, transparent: tuple[int, ...] | None = None) -> bytes:
    """A PNG file of (H, W, 1 to 4) words of 16 bits; `transparent`: the colour of its chunk tRNS."""
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, channels = words.shape
    header = struct.pack(">IIBBBBB", width, height, 16, PNG_COLOURS[channels], 0, 0, 0)
    key = b"" if transparent is None else chunk(b"tRNS", struct.pack(f">{channels}H", *transparent))
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in words)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + key + chunk(b"IDAT", zlib.compress(rows))
            + chunk(b"IEND", b""))


def tiff_of(values: np.ndarray, order: str = "<", bits: int = 16, **tags: int) -> bytes:
    """A TIFF file of (H, W, C) whole numbers in one strip; one for each channel if `PlanarConfiguration` is 2.

    Args:
        values: the numbers.
        order: of the bytes, "<" or ">".
        bits: of each number, 8 or 16.
        **tags: by their names in the specification.
    """
    height, width, channels = values.shape
    apart = tags.get("PlanarConfiguration") == 2
    strips = channels if apart else 1
    pixels = (values.transpose(2, 0, 1) if apart else values).astype(f"{order}u{bits // 8}").tobytes()
    fields = {"ImageWidth": [width], "ImageLength": [height], "BitsPerSample": [bits] * channels, "Compression": [1],
              "PhotometricInterpretation": [1 if channels < 3 else 2], "StripOffsets": [0] * strips,
              "SamplesPerPixel": [channels], "StripByteCounts": [len(pixels) // strips] * strips}
    fields |= {name: [value] for name, value in tags.items()}
    start = 8 + 2 + 12 * len(fields) + 4
    end = start + sum(4 * len(field) for field in fields.values() if len(field) > 1)
    fields["StripOffsets"] = [end + strip * (len(pixels) // strips) for strip in range(strips)]
    entries, beside = b"", b""
    for name in sorted(fields, key=NUMBERS.__getitem__):
        field = fields[name]
        short = name == "BitsPerSample"
        packed = struct.pack(f"{order}{len(field)}{'H' if short or len(field) == 1 and field[0] < 65536 else 'I'}", *field)
        kind = 3 if short or len(field) == 1 and field[0] < 65536 else 4
        if len(packed) > 4:
            packed, beside = struct.pack(f"{order}I", start + len(beside)), beside + packed.ljust(4 * len(field), b"\0")
        entries += struct.pack(f"{order}HHI", NUMBERS[name], kind, len(field)) + packed.ljust(4, b"\0")
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, len(fields))
    return (head + entries + bytes(4) + beside).ljust(end, b"\0") + pixels
