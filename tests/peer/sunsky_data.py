"""Writes the table of `torch_radbp.emitter.sunsky` from what Mitsuba 3.9.1 has: ``python -m tests.peer.sunsky_data``.

The coefficients of Hosek and Wilkie's sky are copied out of its file of data, which it distributes under their licence and
its own; the radiance of the sun's disc is what its emitter returns for each whole turbidity and each of the elevations
between which it interpolates linearly, 2, 5, ... 89 degrees. See `torch_radbp/emitter/sunsky_data.md`.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

import torch_radbp.emitter.sunsky as sunsky

NUMBERS = {10: np.float32, 11: np.float64}  # by the code that stands for them


def tensors(path: Path) -> dict[str, np.ndarray]:
    """The arrays in a file of Mitsuba's tensor format."""
    content = path.read_bytes()
    count, = struct.unpack_from("<I", content, 14)
    place, found = 18, {}
    for _ in range(count):
        length, = struct.unpack_from("<H", content, place)
        name = content[place + 2:place + 2 + length].decode()
        place += 2 + length
        axes, code, first = struct.unpack_from("<HBQ", content, place)
        shape = struct.unpack_from(f"<{axes}Q", content, place + 11)
        place += 11 + 8 * axes
        found[name] = np.frombuffer(content, NUMBERS[code], int(np.prod(shape)), first).reshape(shape)
    return found


def sun_radiance() -> np.ndarray:
    """(10, 30, 3) radiance of the disc of the usual size: turbidity, elevation, channel."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    table = np.zeros((10, len(sunsky.ELEVATIONS), 3))
    for turbidity in range(10):
        for number, elevation in enumerate(np.radians(sunsky.ELEVATIONS)):
            towards = [float(np.cos(elevation)), 0.0, float(np.sin(elevation))]
            emitter = mi.load_dict({"type": "sunsky", "sun_direction": towards, "turbidity": turbidity + 1.0,
                                    "sky_scale": 0.0})
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wi = -mi.Vector3f(towards)
            table[turbidity, number] = emitter.eval(si)
    return table


def main() -> None:
    import mitsuba

    data = tensors(Path(mitsuba.__file__).parent / "data" / "sunsky" / "sunsky_datasets.bin")
    np.savez_compressed(sunsky.DATA, sky_params=data["sky_params_rgb"].astype(np.float32),
                        sky_radiance=data["sky_rad_rgb"].astype(np.float32), sun_radiance=sun_radiance().astype(np.float32))


if __name__ == "__main__":
    main()
