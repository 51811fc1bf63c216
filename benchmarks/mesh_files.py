"""Time and memory to read a mesh of a million triangles: `python -m benchmarks.mesh_files`.

An OBJ and a PLY file with normals and uv are written to a temporary folder. Each is read by this package, by trimesh and, if
it is installed, by Mitsuba (which also places the mesh), each in a process of its own: processor time, and by how much the
peak of memory grows.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.ply import write_ply
from torch_radbp.shape.surface import grid

READERS = {
    "torch_radbp": "from torch_radbp.formats.mesh import read_mesh as read",
    "trimesh": "from trimesh.exchange import obj, ply\n"
               "def read(path):\n"
               "    {'obj': obj.load_obj, 'ply': ply.load_ply}[path[-3:]](open(path, 'rb'), skip_materials=True)",
    "mitsuba": "import mitsuba; mitsuba.set_variant('scalar_rgb')\n"
               "def read(path): mitsuba.load_dict({'type': path[-3:], 'filename': path})",
}
MEASURE = """
import re, sys, time
peak = lambda: int(re.search(r"VmHWM:\\s*(\\d+)", open("/proc/self/status").read())[1]) / 1024
memory, start = peak(), time.process_time()
read(sys.argv[1])
print(f"{time.process_time() - start:6.2f} s {peak() - memory:8.0f} MB")
"""


def write_meshes(folder: Path, columns: int) -> list[Path]:
    """A wavy sheet of 2 x columns x columns triangles, as OBJ and as PLY."""
    uv, faces = (each.numpy() for each in grid(columns, columns))
    vertices = np.column_stack([uv, 0.1 * np.sin(9 * uv).prod(1)]).astype("f4")
    normals = np.column_stack([np.zeros_like(uv), np.ones(len(uv))])
    write_ply(folder / "sheet.ply", MeshArrays(vertices, faces, normals, uv))
    with open(folder / "sheet.obj", "w") as file:
        np.savetxt(file, vertices, "v %.6f %.6f %.6f")
        np.savetxt(file, uv, "vt %.6f %.6f")
        np.savetxt(file, normals, "vn %.4f %.4f %.4f")
        np.savetxt(file, np.repeat(faces + 1, 3, axis=1), "f %d/%d/%d %d/%d/%d %d/%d/%d")
    return [folder / "sheet.obj", folder / "sheet.ply"]


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=707, help="of squares; their square times two are the triangles")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for path in write_meshes(Path(folder), options.columns):
            for name, reader in READERS.items():
                command = [sys.executable, "-c", reader + MEASURE, str(path)]
                done = subprocess.run(command, capture_output=True, text=True)
                missing = "not installed" if "ModuleNotFoundError" in done.stderr else done.stderr
                print(f"{path.suffix[1:].upper()} {name:12} {done.stdout.strip() or missing}")


if __name__ == "__main__":
    main()
