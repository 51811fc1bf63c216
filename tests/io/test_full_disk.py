"""A disk that is full: the message names the file, and the old one is still there."""

import errno
import signal

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.io.documents import scene_dict
from torch_radbp.formats.atomic import replacing
from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.ply import write_ply

pytestmark = pytest.mark.hostile

resource = pytest.importorskip("resource")


@pytest.fixture
def small_disk():
    """No file may grow beyond 2000 bytes."""
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


WRITERS = {
    "a.exr": lambda path: rb.save_image(path, torch.rand(3, 64, 64)),
    "a.png": lambda path: rb.save_image(path, torch.rand(3, 64, 64)),
    "a.ply": lambda path: write_ply(path, MeshArrays(np.zeros((900, 3)), np.zeros((1, 3), "i8"), None, None)),
    "a.xml": lambda path: rb.save(rb.load_dict(scene_dict(**{f"s{i}": {"type": "sphere"} for i in range(40)})), path),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_names_the_file_and_leaves_the_old_one(tmp_path, small_disk, name):
    (tmp_path / name).write_text("old")
    with pytest.raises(OSError, match=rf"{name}: cannot be written: ") as caught:
        WRITERS[name](tmp_path / name)
    assert "File too large" in str(caught.value) and "\n" not in str(caught.value)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]


def test_the_number_of_the_error_is_kept(tmp_path):
    with pytest.raises(OSError, match="a: cannot be written: No space left on device") as caught:
        with replacing(tmp_path / "a"):
            raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.errno == errno.ENOSPC
