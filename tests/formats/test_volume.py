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
    assert np.array_equal(read_volume(tmp_path / "g.vol"), VALUES)
    assert read_volume(tmp_path / "g.vol").dtype == np.float32


def test_mitsuba_reads_and_writes_the_same(tmp_path, mi):
    mi.VolumeGrid(VALUES).write(str(tmp_path / "theirs.vol"))
    write_volume(tmp_path / "ours.vol", VALUES)
    assert np.array_equal(read_volume(tmp_path / "theirs.vol"), VALUES)
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
