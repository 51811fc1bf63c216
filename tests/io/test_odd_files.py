"""Folders, devices and files cut short in the place of scenes, images and outputs: one message that says so."""

import errno
import os
import subprocess
import sys
import warnings

import numpy as np
import OpenEXR
import pytest
import torch

import torch_radbp as rb
from tests.io.colmap_files import CAMERAS, IMAGES
from tests.io.documents import scene_dict
from tests.io.nerf_files import BLENDER
from torch_radbp.formats.image import read_image, save_image
from torch_radbp.formats.mesh import read_mesh
from torch_radbp.training.recipe_file import read_recipe

pytestmark = pytest.mark.hostile

READERS = {"scene": (rb.load, ("", ".xml", ".glb", ".gltf")), "image": (read_image, ("", ".exr", ".png", ".hdr", ".pfm")),
           "mesh": (read_mesh, ("", ".ply", ".obj", ".serialized"))}
CASES = [(what, suffix) for what, (_, suffixes) in READERS.items() for suffix in suffixes]


@pytest.mark.parametrize("what, suffix", CASES)
def test_folders_and_devices_are_no_files(what, suffix, tmp_path):
    read, _ = READERS[what]
    folder, device = tmp_path / f"folder{suffix}", tmp_path / f"zero{suffix}"
    folder.mkdir()
    device.symlink_to("/dev/zero")
    for path, message in ((folder, "is a folder, not a file"), (device, "is not an ordinary file")):
        with pytest.raises((ValueError, OSError)) as caught:
            read(path)
        assert str(caught.value) == f"{path}: {message}"


@pytest.mark.parametrize("key", ["scene", "targets.0.image"])
@pytest.mark.parametrize("place, message", [("folder", "is a folder, not a file"), ("gone", "no such file"),
                                            ("device", "leads out of the recipe's folder")])
def test_recipes_of_such(key, place, message, tmp_path):
    (tmp_path / "recipe.toml").write_text('scene = "s.xml"\nsteps = 1\n[[targets]]\nimage = "t.exr"\n'
                                          '[[parameters]]\nname = "x"\n')
    for name in ("s.xml", "t.exr"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "folder").mkdir()
    (tmp_path / "device").symlink_to("/dev/zero")
    with pytest.raises(ValueError, match=message) as caught:
        read_recipe(tmp_path / "recipe.toml", [f"{key}='{place}'"])
    assert str(tmp_path / place) in str(caught.value) or f"{place!r}" in str(caught.value)


@pytest.mark.parametrize("size", [8, 50, 200, 330])
def test_an_exr_cut_short_in_its_header(size, tmp_path):
    path = tmp_path / "a.exr"
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage},
                 {"RGB": np.zeros((4, 4, 3), "f4")}).write(str(path))
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(ValueError) as caught:
        read_image(path)
    assert str(caught.value) == f"{path}: cannot be read as EXR: its header is damaged, or the file is cut short"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_standard_output():
    program = ("import sys; from torch_radbp.training.cli import main; "
               "sys.argv = ['radbp', 'optimize', '--list']; main()")
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", program], stdout=full, stderr=subprocess.PIPE, text=True, timeout=120)
    assert done.returncode != 0 and os.strerror(errno.ENOSPC) in done.stderr


def test_a_file_as_the_folder_of_a_run(tmp_path):
    from torch_radbp.training.recovery.run_folder import RunFolder

    (tmp_path / "run").write_text("")
    with pytest.raises(FileExistsError, match="run: is no folder; --out names the folder of the run"):
        RunFolder(tmp_path / "run").start(None)


def test_devices_as_outputs():
    with pytest.raises(ValueError, match=r"/dev/full: unknown kind of image ''; supported: \.exr, \.png"):
        save_image("/dev/full", torch.zeros(3, 2, 2))
    with pytest.raises(ValueError, match=r"a scene is written as \.xml, \.glb or \.gltf"):
        rb.save(rb.load_dict(scene_dict(ball={"type": "sphere"})), "/dev/full")


def colmap(folder, mark=b"", **files):
    for name, text in ({"cameras": CAMERAS, "images": IMAGES} | files).items():
        (folder / f"{name}.txt").write_bytes(mark + text.encode())
    return folder


def test_colmap_with_a_byte_order_mark(tmp_path):
    (tmp_path / "plain").mkdir()
    marked, plain = (rb.cameras_from_colmap(colmap(folder, mark))
                     for folder, mark in ((tmp_path, b"\xef\xbb\xbf"), (tmp_path / "plain", b"")))
    assert list(marked) == list(plain)
    lines = [line for line in CAMERAS.splitlines() if line and not line.startswith("#")]
    (tmp_path / "bare").mkdir()
    bare = colmap(tmp_path / "bare", b"\xef\xbb\xbf", cameras="\n".join(lines) + "\n")  # the mark stands before a number
    assert list(rb.cameras_from_colmap(bare)) == list(plain)


@pytest.mark.parametrize("rfilter, error, message", [
    ("boxx", ValueError, "rfilter 'boxx' is not known; did you mean 'box'"),
    (3, TypeError, r"rfilter must be a reconstruction filter or the name of one \(box, .*\), got 3"),
    ({"type": "box"}, TypeError, "rfilter must be a reconstruction filter or the name of one"),
])
def test_filters_of_cameras(rfilter, error, message, tmp_path):
    with pytest.raises(error, match=message):
        rb.cameras_from_colmap(colmap(tmp_path), rfilter=rfilter)


def test_filters_of_cameras_by_name(tmp_path):
    cameras = rb.cameras_from_colmap(colmap(tmp_path), rfilter="box")
    assert {camera.film.rfilter.type for camera in cameras.values()} == {"box"}


def nerf_scene(tmp_path, **emitter):
    import json

    (tmp_path / "transforms.json").write_text(json.dumps(BLENDER))
    cameras = rb.cameras_from_nerf(tmp_path / "transforms.json", width=8, height=6)
    return {"type": "scene", **cameras, "sky": emitter, "ball": {"type": "sphere"}}


TURN = [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]


def test_an_environment_map_under_cameras_of_nerf_is_hinted_at(tmp_path):
    image = np.ones((2, 4, 3))
    with pytest.warns(UserWarning) as found:
        rb.load_dict(nerf_scene(tmp_path, type="envmap", bitmap=image))
    assert [str(each.message) for each in found] == [
        "sky: its pole is [0.0, 1.0, 0.0], but in the world of the cameras (0.0, 0.0, 1.0) points up; turn it, with "
        "to_world=[[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]] from y to z"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rb.load_dict(nerf_scene(tmp_path, type="envmap", bitmap=image, to_world=TURN))
        rb.load_dict(nerf_scene(tmp_path, type="constant"))
        rb.load_dict(scene_dict(sky={"type": "envmap", "bitmap": image}))


@pytest.mark.parametrize("place", ["scene", "group"])
def test_a_mesh_that_mitsuba_has_made(mi, place):
    made = mi.Mesh("made", 3, 1)
    objects = {"wall": made} if place == "scene" else {"wall": {"type": "shapegroup", "made": made}}
    with pytest.raises(rb.SceneError) as caught:
        rb.load_dict(scene_dict(**objects))
    assert ('a mesh that Mitsuba has made is given as {"type": "mesh"} with arrays: vertex_positions of its '
            "vertex_positions_buffer(), (V, 3), and faces of its faces_buffer(), (F, 3)") in str(caught.value)
