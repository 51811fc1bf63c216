"""Grids of numbers in Mitsuba's volume format: what Mitsuba writes is read, and damaged files are refused by name."""

import struct

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.scenes import load, sensor
from torch_radbp.formats.volume import HEADER, read_volume, write_volume
from torch_radbp.io.write import save

VALUES = np.random.default_rng(0).uniform(-1, 1, (4, 3, 5, 1)).astype("f4")


def test_what_is_written_is_read(tmp_path):
    write_volume(tmp_path / "g.vol", VALUES)
    assert np.array_equal(read_volume(tmp_path / "g.vol").values, VALUES)
    assert read_volume(tmp_path / "g.vol").values.dtype == np.float32


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_channels_and_the_box_are_written_and_read(tmp_path, channels):
    values, box = np.arange(60 * channels, dtype="f4").reshape(4, 3, 5, channels), (-1.0, -2.0, 0.5, 1.0, 3.0, 2.0)
    write_volume(tmp_path / "g.vol", values, box)
    found = read_volume(tmp_path / "g.vol", (1, 3, 6))
    assert np.array_equal(found.values, values) and found.box == box


def test_other_numbers_of_channels_are_refused(tmp_path):
    write_volume(tmp_path / "g.vol", np.zeros((2, 2, 2, 4), "f4"))
    with pytest.raises(ValueError, match="g.vol: it must have 1 or 3 or 6 channels, got 4"):
        read_volume(tmp_path / "g.vol", (1, 3, 6))


@pytest.mark.parametrize("header", [b"", bytes(12), bytes(20)])
def test_a_header_that_asks_for_much_allocates_nothing(tmp_path, header):
    """2^31 - 1 cells along each axis, of a file that ends behind its header."""
    (tmp_path / "g.vol").write_bytes(HEADER.pack(b"VOL", 3, 1, *(2**31 - 1,) * 3, 6, *(0,) * 6) + header)
    with pytest.raises(ValueError, match="values of 6 channels need .* bytes after the header, got"):
        read_volume(tmp_path / "g.vol", (1, 3, 6))


def test_mitsuba_reads_and_writes_the_same(tmp_path, mi):
    mi.VolumeGrid(VALUES).write(str(tmp_path / "theirs.vol"))
    write_volume(tmp_path / "ours.vol", VALUES)
    assert np.array_equal(read_volume(tmp_path / "theirs.vol").values, VALUES)
    assert np.array_equal(np.array(mi.VolumeGrid(str(tmp_path / "ours.vol"))).reshape(VALUES.shape), VALUES)


def test_a_grid_is_read_from_a_file_and_written_back(tmp_path):
    write_volume(tmp_path / "g.vol", VALUES)
    scene = load(torch.float32, camera=sensor(2), sky={"type": "constant"}, shape={
        "type": "sdfgrid", "filename": str(tmp_path / "g.vol"), "normals": "analytic"})
    assert np.array_equal(scene.shape.grid.detach().numpy(), VALUES)
    scene.shape.grid.data *= 2
    scene.shape.to_world.data[0, 3] = 0.5
    save(scene, tmp_path / "scene.xml")
    (tmp_path / "g.vol").unlink()
    again = rb.load(tmp_path / "scene.xml").shape
    assert np.array_equal(again.grid.detach().numpy(), 2 * VALUES) and again.normals == "analytic"
    assert torch.equal(again.to_world, scene.shape.to_world)


def changed(**fields) -> bytes:
    """The file with some numbers of its header changed."""
    given = {"magic": b"VOL", "version": 3, "kind": 1, "x": 5, "y": 3, "z": 4, "channels": 1} | fields
    return HEADER.pack(*given.values(), 0, 0, 0, 1, 1, 1) + VALUES.tobytes()


@pytest.mark.parametrize("content, message", [
    (b"", "cut short, a volume begins with 48 bytes, got 0"),
    (changed(magic=b"VOX"), "a volume begins with b'VOL', got b'VOX'"),
    (changed(version=2), "the version must be 3, got 2"),
    (changed(kind=2), r"its numbers must be float32 \(kind 1\), got kind 2"),
    (changed(x=0), "its sizes along x, y and z must be at least 1, got 0, 3, 4"),
    (changed(y=-3), "its sizes along x, y and z must be at least 1, got 5, -3, 4"),
    (changed(channels=3), "it must have one channel, got 3"),
    (changed(x=2**31 - 1, y=2**31 - 1),
     "2147483647 x 2147483647 x 4 values need .* bytes after the header, got 240; is the file cut short"),
    (changed()[:-1], "5 x 3 x 4 values need 240 bytes after the header, got 239"),
    (changed() + b"0", "5 x 3 x 4 values need 240 bytes after the header, got 241"),
    (changed()[:-8] + struct.pack("<2f", float("nan"), 1), "1 of its values are NaN or infinite, the first of them at "
                                                           "x, y, z = 3, 2, 3"),
])
def test_damaged_files_are_refused_by_name(tmp_path, content, message):
    path = tmp_path / "bad.vol"
    path.write_bytes(content)
    with pytest.raises(rb.SceneError, match=f"bad.vol: {message}"):
        load(sensor=sensor(2), sky={"type": "constant"}, shape={"type": "sdfgrid", "filename": str(path)})
