"""What rays cost in trees, counted: ``python -m benchmarks.trees`` (``--scene NAME``), and ``--instances 1000``.

Boxes and triangles that a ray is tested against, of the rays of paths (`benchmarks.rays`): from the camera, after the first
bounce, and to lights. First of a ray by itself; then of 32 that wait for each other in each step, as threads of a GPU do:
two boxes if any of them tests boxes, and the most triangles that one of them tests. Trees are those of Warp's constructors
with so many triangles in a leaf, searched as it does (`mesh.h`); "lbvh" is what it builds on GPUs if nothing is said, and
built here after its rules (`lbvh.py`), since its CPU device does not know it. What a box and a triangle take on a card this
does not say.

``--instances N`` counts the same in a field of N instances of a mesh (``--triangles``), in one tree of copies and in the two
levels of `raycast/warp_instances.py`, with the instances that a ray is transformed into; ``--memory`` says instead what
memory both take on Warp's CPU device, each in a process of its own.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

import torch_radbp as rb
from benchmarks.instances import field_of
from benchmarks.lbvh import tree_of
from benchmarks.rays import SCENES, Query, Recorder, recorded
from benchmarks.resident import MIB, give_back, peak_of, resident
from benchmarks.scenes import ALL, QUICK
from benchmarks.tree_counts import TOGETHER, Counts, TwoLevels, counted, given
from torch_radbp import raycast
from torch_radbp.interface.instances import expanded
from torch_radbp.raycast import Ray, make_caster
from torch_radbp.raycast.warp_tree import in_units, power_of_2_units
from torch_radbp.rendering.cast_triangles import cast_triangles
from torch_radbp.scene.packing.pack import pack

RESOLUTION = 64
COUNTED = ["metal-mesh", "million", "room", "material-room"]
TREES = [(constructor, leaf_size) for constructor in ("lbvh", "sah", "cubql") for leaf_size in (4, 1, 8)]


def queries_of(recorder: Recorder) -> dict[str, Query]:
    """The rays that are counted: from the camera, after the first bounce, and to lights."""
    found = {"camera": recorder.closest[0], "bounced": recorder.closest[1]}
    if recorder.shadow:
        shadow = recorder.shadow[0]
        some = shadow.tmax > 0
        found["shadow"] = Query(Ray(*(vector.map(lambda lanes: lanes[some]) for vector in shadow.ray)), shadow.tmax[some])
    return found


def row(name: str, nodes: int, counts: Sequence[Counts], instances: bool) -> str:
    """A line of the table: of each kind of rays boxes + triangles, and the same of rays that wait for each other."""
    cells = [f"{each.boxes:.0f} + {each.triangles:.0f}, {each.boxes_together:.0f} + {each.triangles_together:.0f}"
             + f", {each.instances:.1f}" * instances for each in counts]
    return f"| {name} | {nodes:,} | {' | '.join(cells)} |"


def header(kinds: Sequence[str], instances: bool) -> str:
    what = f"boxes + triangles, of {TOGETHER} together" + ", instances" * instances
    return (f"| tree, triangles in a leaf | nodes | {' | '.join(f'{kind}: {what}' for kind in kinds)} |\n"
            f"|---|---|{'---|' * len(kinds)}")


def scene_of(name: str, resolution: int) -> rb.Scene:
    """A scene of `benchmarks.rays` or of the benchmarks."""
    if name in SCENES:
        return SCENES[name](resolution)
    with tempfile.TemporaryDirectory() as folder:
        return ALL[name].make(Path(folder), QUICK._replace(resolution=resolution)).load()


def rows_of_scene(name: str, resolution: int, trees: Sequence[tuple[str, int]]) -> list[str]:
    """The table of a scene."""
    recorder = recorded(scene_of(name, resolution), resolution)
    queries = queries_of(recorder)
    return [header(list(queries), False), *rows_of_copies(recorder.vertices, recorder.faces, queries, trees, False)]


def rows_of_copies(vertices: Tensor, faces: Tensor, queries: dict[str, Query], trees: Sequence[tuple[str, int]],
                   instances: bool) -> list[str]:
    """Lines of a mesh in one tree."""
    corners = vertices.float()[faces.long()]
    unit = power_of_2_units(float((corners.amax((0, 1)) - corners.amin((0, 1))).amax()))
    corners, rows = in_units(corners, unit), []
    for constructor, leaf_size in trees:
        tree = tree_of(constructor, leaf_size, corners)
        flat = given(tree, corners)
        counts = [counted(flat, tree.roots[0], query, unit)[0] for query in queries.values()]
        rows.append(row(f"{constructor}, {leaf_size}", tree.nodes, counts, instances))
    return rows


def rows_of_field(scene: rb.Scene, resolution: int, trees: Sequence[tuple[str, int]]) -> list[str]:
    """The table of a field of instances: copies in one tree, then two levels."""
    recorder = recorded(scene, resolution)
    queries, shown = queries_of(recorder), recorder.caster.instances
    copies = expanded(recorder.vertices, recorder.faces, shown)
    rows = [header(list(queries), True), *rows_of_copies(*copies[:2], queries, trees, True)]
    for constructor, leaf_size in trees:
        levels = TwoLevels.of(recorder.vertices, recorder.faces, shown, constructor, leaf_size)
        counts = [levels.counted(query)[0] for query in queries.values()]
        rows.append(row(f"two levels: {constructor}, {leaf_size}", levels.nodes, counts, True))
    return rows


def report_memory(instances: int, triangles: int, copied: bool) -> None:
    """Prints by how much this process grows when a caster of a field is made, in the end and at the most."""
    with torch.no_grad():
        vertices, faces, _, shown = cast_triangles(pack(field_of(instances, triangles, 8)).triangles).stacked()
    raycast.MOST_COPIED = 1 << 62 if copied else 0
    make_caster("warp", torch.eye(3), torch.arange(3)[None])  # Warp itself
    give_back()
    before, casters = resident("VmRSS"), []
    most = peak_of(lambda: casters.append(make_caster("warp", vertices, faces, None, shown)))
    give_back()
    kept = resident("VmRSS") - before
    print(f"{'copies' if copied else 'two levels'}: {shown.triangles():,} triangles, {most / MIB:.0f} MiB while they are "
          f"made, {kept / MIB:.0f} MiB then", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=[*SCENES, *ALL], nargs="+", default=COUNTED)
    parser.add_argument("--resolution", type=int, default=RESOLUTION, help="pixels along a side")
    parser.add_argument("--instances", type=int, help="count in a field of so many instances instead")
    parser.add_argument("--triangles", type=int, default=1000, help="of each")
    parser.add_argument("--larger", type=float, default=1.0, help="so many times larger: from 2 on they pierce each other")
    parser.add_argument("--memory", action="store_true", help="measure what the trees of such a field take instead")
    options = parser.parse_args()
    if options.memory:
        for copied in (False, True):
            process = multiprocessing.get_context("spawn").Process(
                target=report_memory, args=(options.instances or 1000, options.triangles, copied))
            process.start()
            process.join()
    elif options.instances:
        scene = field_of(options.instances, options.triangles, options.resolution, options.larger)
        print("\n".join(rows_of_field(scene, options.resolution, [("lbvh", 4), ("lbvh", 1)])))
    else:
        for name in options.scene:
            print(f"{name}\n" + "\n".join(rows_of_scene(name, options.resolution, TREES)), flush=True)


if __name__ == "__main__":
    main()
