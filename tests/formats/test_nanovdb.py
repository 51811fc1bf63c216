"""NanoVDB files: values and places against NVIDIA Warp, which has files to read, and bad ones."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.scenes import load, overhead
from tests.scenes.smoke import box, placed
from torch_radbp.formats.nanovdb import CLASS, HEADER, TREE, read_nanovdb
from torch_radbp.io.build import build_plugin
from torch_radbp.plugin import SceneError
from torch_radbp.tensors.vec import Vec3

warp = pytest.importorskip("warp", reason="its package has files")
FILES = Path(warp.__file__).parent
CUBE, TORUS, SEVERAL = (FILES / "tests" / "assets" / f"{name}.nvdb" for name in ("test_grid", "torus", "test_index_grid"))


@warp.kernel
def looked_up(volume: warp.uint64, places: warp.array(dtype=warp.vec3), found: warp.array(dtype=float)):
    """Interpolates at places in the world."""
    number = warp.tid()
    found[number] = warp.volume_sample_f(volume, warp.volume_world_to_index(volume, places[number]), warp.Volume.LINEAR)


def volume_of(path: Path):
    with open(path, "rb") as file:
        return warp.Volume.load_from_nvdb(file, device="cpu")


def density(path: Path, folder: Path, codec: str = "none") -> Path:
    """A copy of a file whose grid is no level set, and not compressed."""
    volume_of(path).save_to_nvdb(folder / "smoke.nvdb", codec)
    data = bytearray((folder / "smoke.nvdb").read_bytes())
    if codec == "none":
        data[data.index(b"NanoVDB", 8) + CLASS] = 0
    (folder / "smoke.nvdb").write_bytes(data)
    return folder / "smoke.nvdb"


@pytest.mark.parametrize("path", [CUBE, TORUS], ids=["cube", "torus"])
def test_values_at_places_are_those_of_warp(path, tmp_path):
    """Inside of what is set, and a little beyond; a torus is thin, and has values that stand for whole nodes."""
    file, volume = density(path, tmp_path), volume_of(path)
    dense = read_nanovdb(file)
    lift = -float(dense.values.min())  # a volume has no negative values
    grid = build_plugin({"type": "gridvolume", "data": torch.from_numpy(dense.values + lift), "to_world": dense.to_world},
                        "volume").double()
    generator = torch.Generator().manual_seed(0)
    corners = grid.corners()
    places = torch.lerp(corners.amin(0), corners.amax(0), 0.03 + 0.94 * torch.rand(999, 3, generator=generator).double())
    found = warp.zeros(len(places), dtype=float, device="cpu")
    world = warp.array(places.float().numpy(), dtype=warp.vec3, device="cpu")
    warp.launch(looked_up, len(places), [volume.id, world, found], device="cpu")
    value = grid.kind().values(grid.table(), Vec3.of(places))[0] - lift
    expected = torch.from_numpy(found.numpy()).double()
    assert expected.abs().max() > 0.2 and expected.std() > 0.05
    torch.testing.assert_close(value, expected, rtol=1e-4, atol=1e-4 * float(expected.abs().max()))


def test_zipped_grids_are_read_alike(tmp_path):
    first, second = (read_nanovdb(density(CUBE, tmp_path, codec)) for codec in ("none", "zip"))
    assert np.array_equal(first.values, second.values) and np.array_equal(first.to_world, second.to_world)
    assert first.values.shape == (23, 23, 23, 1) and first.values.max() == 1000


def test_three_numbers_at_a_point_are_read(tmp_path):
    values = read_nanovdb(CUBE.with_name("test_vec_grid.nvdb")).values
    assert values.shape == (23, 23, 23, 3) and not np.array_equal(values[..., 0], values[..., 1])


def test_a_grid_is_written_as_a_volume_that_stands_where_it_does(tmp_path):
    values = np.random.default_rng(0).random((5, 9, 20), np.float32)  # along x, y and z
    warp.Volume.load_from_numpy(values, (-1.0, -0.5, 0.5), 0.1, 0.0, device="cpu").save_to_nvdb(tmp_path / "smoke.nvdb")
    flame = {"type": "heterogeneous", "emission": {"type": "gridvolume", "filename": str(tmp_path / "smoke.nvdb")},
             "sigma_t": {"type": "gridvolume", "data": torch.ones(1, 1, 1), "to_world": placed()}}
    scene = load(torch.float32, camera=overhead(4), box=box(flame))
    grid = scene.box.interior.emission
    place = torch.tensor([[-0.7, 0.1, 1.5]])  # at the indices 3, 6 and 10
    assert float(grid.kind().values(grid.table(), Vec3.of(place))[0]) == pytest.approx(float(values[3, 6, 10]), rel=1e-4)
    rb.save(scene, tmp_path / "scene.xml")
    again = rb.load(tmp_path / "scene.xml")
    torch.testing.assert_close(again.box.interior.emission.corners(), grid.corners())
    first, second = (rb.render(each, spp=4, seed=1) for each in (scene, again))
    assert first.max() > 0
    torch.testing.assert_close(first, second)


def patched(at: int, form: str, *values):
    """A change of numbers at a place in the grid."""
    def change(data: bytearray) -> bytearray:
        struct.pack_into(form, data, data.index(b"NanoVDB", 8) + at, *values)
        return data
    return change


def with_codec(data: bytearray) -> bytearray:
    """Says that the grids are compressed by BLOSC."""
    struct.pack_into("<H", data, HEADER.size - 2, 2)
    return data


BAD = {
    "nothing": (lambda data: b"", "broken, or cut short at 0 bytes"),
    "another format": (lambda data: b"VOL" + data, "a NanoVDB file begins with b'NanoVDB2', got"),
    "header alone": (lambda data: data[:HEADER.size], "broken, or cut short at 16 bytes"),
    "cut in the middle": (lambda data: data[:len(data) // 2], "is the file cut short"),
    "compressed by another program": (with_codec, "2: BLOSC"),
    "integers": (patched(CLASS + 4, "<I", 4), "float32, one or three at a point, .* got type 4"),
    "level set": (patched(CLASS, "<I", 1), "no distances to a surface"),
    "no grid": (patched(0, "<8s", b"anything"), "a grid begins with"),
    "a tree that points nowhere": (patched(TREE + 24, "<q", 1 << 60), "broken"),
    "a root that points before the file": (patched(TREE + 24, "<q", -(1 << 40)), "broken"),
}


@pytest.mark.parametrize("change, message", BAD.values(), ids=BAD)
def test_bad_files_are_refused_by_name(change, message, tmp_path):
    file = density(CUBE, tmp_path)
    file.write_bytes(change(bytearray(file.read_bytes())))
    with pytest.raises(ValueError, match=f"smoke.nvdb: .*{message}"):
        read_nanovdb(file)


def test_whatever_bytes_change_a_file_is_read_or_refused(tmp_path):
    """Also one that is zipped; of the bytes that say what follows."""
    generator, refused = np.random.default_rng(0), 0
    for codec in ("none", "zip"):
        good = density(CUBE, tmp_path, codec).read_bytes()
        start = good.index(b"NanoVDB", 8) if codec == "none" else 0
        marks = [0, 60, start, start + CLASS, start + TREE, start + TREE + 64, start + TREE + 128]
        for _ in range(50):
            data = bytearray(good)
            data[min(int(generator.choice(marks) + generator.integers(64)), len(data) - 1)] = generator.integers(256)
            (tmp_path / "smoke.nvdb").write_bytes(data)
            try:
                read_nanovdb(tmp_path / "smoke.nvdb")
            except ValueError as error:
                assert "smoke.nvdb: " in str(error)
                refused += 1
    assert 8 < refused < 100


def test_grids_that_are_larger_than_memory_are_refused_before_it_is_asked_for(tmp_path):
    file = density(CUBE, tmp_path)
    data = bytearray(file.read_bytes())
    grid = data.index(b"NanoVDB", 8)
    root, = struct.unpack_from("<q", data, grid + TREE + 24)
    struct.pack_into("<3i", data, grid + TREE + root + 12, 1 << 20, 1 << 20, 1 << 20)
    file.write_bytes(data)
    with pytest.raises(ValueError, match="smoke.nvdb: its values are set in a box of 1048587 x .* resample"):
        read_nanovdb(file)


@pytest.mark.parametrize("attributes, message", [
    ({"filename": str(SEVERAL)}, "grid_name must be one of 'grid-0', 'grid-1', got None"),
    ({"filename": str(SEVERAL), "grid_name": "smoke"}, "grid_name must be one of 'grid-0', 'grid-1', got 'smoke'"),
    ({"filename": "smoke.vdb"}, "OpenVDB files are not read; convert it by `nanovdb_convert"),
    ({"data": torch.ones(2, 2, 2), "grid_name": "smoke"}, "grid_name 'smoke' needs the filename of a .nvdb")], ids=str)
def test_what_cannot_be_read_is_said(attributes, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "smoke.vdb").touch()
    with pytest.raises((SceneError, ValueError), match=message):
        build_plugin({"type": "gridvolume"} | attributes, "volume")
