"""Single faults, and whether the tests find them: ``python -m tests.mutants``.

Each fault is put into a copy of the tree, and the quick tests of the folders that are named beside it run there until one
fails; if none does, the deep ones of these folders, then all quick and all deep tests. What no test finds is printed as
such, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
LEFT_ASIDE = shutil.ignore_patterns(".git", ".venv", "runs", "build", "dist", "*.egg-info", "__pycache__", ".pytest_cache")


class Mutant(NamedTuple):
    """A fault."""

    file: str  # below torch_radbp
    right: str  # stands there once
    wrong: str
    tests: tuple[str, ...]  # folders or files below tests, where it should show first


MUTANTS = (
    # Derivatives.
    Mutant("adjoint/bounce.py", "Memo((local.E + local.F * memo.L).detach()", "Memo((local.E + local.F).detach()",
           ("adjoint/test_furnace.py",)),
    Mutant("adjoint/bounce.py", "adj_L = adj_L * state.beta", "adj_L = adj_L * 1.0",
           ("adjoint/test_furnace.py",)),
    Mutant("vertex/outgoing_ray.py", "element = dot(cross(e1, e2), aim).abs() / squared",
           "element = dot(cross(e1, e2), aim).abs() / squared.detach()",
           ("derivatives/test_ablation.py", "derivatives/test_expectation.py")),
    Mutant("boundary/eye/deposit.py", "* normal.x + (seen.y", "* normal.x - (seen.y",
           ("derivatives/test_shadows.py", "boundary")),
    Mutant("texture/bank.py", "by_y = ((lower_left - upper_left)", "by_y = ((upper_left - lower_left)",
           ("bsdf/test_bumpmap.py",)),
    Mutant("vertex/material.py", "return settled(chance) / chance", "return settled(chance) / settled(chance)",
           ("derivatives/test_expectation.py",)),
    Mutant("bsdf/fresnel.py", "product = eta * k  # a b", "product = eta * k.detach()", ("bsdf/test_derivatives.py",)),
    Mutant("texture/pyramid.py", "return finer * (1.0 - at.share) + coarser * at.share",
           "return finer * (1.0 - at.share.detach()) + coarser * at.share.detach()",
           ("texture/test_trilinear.py", "derivatives/test_gradcheck.py")),
    # Densities.
    Mutant("sampling/warp.py", "return Vec2(root * (1.0 - v), root * v)", "return Vec2(u * (1.0 - v), u * v)",
           ("sampling/test_warp.py",)),
    Mutant("emitter/area.py", "return density * (distance * distance) /", "return density * distance /",
           ("adjoint/test_furnace.py", "emitter/test_estimators.py")),
    Mutant("bsdf/microfacet.py", "2.276 * w.z * t", "2.376 * w.z * t", ("bsdf/test_mitsuba.py", "bsdf/test_energy.py")),
    Mutant("bsdf/blendbsdf.py", "chance = weight.clamp(LEAST_CHANCE, 1.0 - LEAST_CHANCE)",
           "chance = weight.clamp(0.0, 1.0 - LEAST_CHANCE)", ("bsdf/test_nested.py", "bsdf/test_both_orders.py")),
    Mutant("path/surface.py", "thinning = 1.0 / survival if", "thinning = torch.rsqrt(survival) if",
           ("adjoint/test_furnace.py", "rendering/test_estimators.py")),
    Mutant("scene/tables/light_choice.py", "return element, chance * lookup(choice.pmf, element)", "return element, chance",
           ("emitter/test_light_choice.py",)),
    # Films.
    Mutant("film/position.py", "(row + self.origin.y", "(row + self.origin.x",
           ("sensor", "rendering/test_camera.py")),
    Mutant("film/gaussian.py", "stddev**2)) - math.exp(-0.5 * CUT**2)", "stddev**2)) - 0 * math.exp(-0.5 * CUT**2)",
           ("film",)),
    Mutant("film/splat.py", "entry + (down * row + across * column)", "entry + (down * column + across * row)",
           ("film/test_splat.py",)),
    Mutant("film/develop.py", "first, end = max(self.done, offset), min(last, rows + offset)",
           "first, end = max(self.done, offset), min(last, rows)", ("film/test_splat.py",)),
    Mutant("film/mitchell.py", "(-12 * b - 48 * c) * x", "(-12 * b - 46 * c) * x", ("film",)),
    # Readers.
    Mutant("io/values/transform.py", "np.array([[0, -z, y], [z, 0, -x]", "np.array([[0, z, y], [z, 0, -x]",
           ("io/test_transform.py",)),
    Mutant("io/gltf/material.py", 'scaled(image, 1, numbers["roughness"])', 'scaled(image, 2, numbers["roughness"])',
           ("io/test_gltf.py",)),
    Mutant("formats/obj.py", "np.where(index > 0, index - 1, before + index)", "np.where(index > 0, index - 1, index)",
           ("formats/test_mesh.py", "formats/test_bad_mesh.py")),
    # Boundary terms.
    Mutant("boundary/curve/edge_places.py", "scale = times * reach", "scale = times", ("boundary/test_primary.py",)),
    Mutant("boundary/curve/inner_lines.py", "return -volume * (normal.x", "return volume * (normal.x",
           ("boundary/test_intersections.py", "derivatives/test_crossing_bodies.py")),
    Mutant("boundary/curve/segments.py", "(f0, f1, f2)[(2 + other) % 3]", "(f0, f1, f2)[(1 + other) % 3]",
           ("boundary/test_intersections.py", "boundary/test_texture_lines.py")),
    Mutant("boundary/curve/contour.py", "return 2.0 * (at_1 - at_0), 2.0 *", "return (at_1 - at_0),",
           ("boundary/test_rims.py", "boundary/test_cuts.py")),
    Mutant("boundary/curve/geometry.py",
           "normals if instance is None else shown_normals(geometry, _ShownBy(instance), normals)",
           "normals", ("boundary/test_rims.py", "derivatives/test_inner_jumps.py")),
    Mutant("boundary/curve/contacts.py", "0.5 - 0.5 * pierces.double()", "1.0 - pierces.double()",
           ("derivatives/test_contacts.py",)),
    Mutant("boundary/eye/lines_through_edges.py", "facing * per_distance * per_distance", "per_distance * per_distance",
           ("boundary/test_lines_through_edges.py", "derivatives/test_shadows.py")),
    Mutant("boundary/terms/crossed_surfaces.py", "growth = side * torch.sqrt(", "growth = torch.sqrt(",
           ("boundary/test_crossed_surfaces.py", "derivatives/test_nearby.py")),
    Mutant("boundary/eye/seen_edges.py", "torch.sqrt(dot(normal, normal)) / (dot(p, p) * angle)",
           "torch.sqrt(dot(normal, normal)) / dot(p, p)", ("boundary/test_edge_tree.py", "derivatives/test_shadows.py")),
    Mutant("boundary/terms/spread_borders.py", "((1 + len(spans)) / density)", "(len(spans) / density)",
           ("boundary/test_spread_borders.py", "derivatives/test_shadows.py")),
    Mutant("boundary/eye/edge_tree.py", "u, at.chance * share)", "u, share)",
           ("boundary/test_edge_tree.py", "boundary/test_segment_tree.py")),
    Mutant("boundary/terms/reflections.py", "slope.x.abs() + slope.y.abs()",
           "torch.maximum(slope.x.abs(), slope.y.abs())", ("derivatives/test_mirrors.py",)),
    # Media.
    Mutant("path/panes.py", "* panes.others * panes.count", "* panes.others", ("medium/test_panes.py",)),
    Mutant("path/passage.py", "longer = segment / settled(segment)", "longer = segment / segment",
           ("medium/test_heterogeneous.py", "medium/test_boundaries.py")),
    Mutant("path/passage.py", "left / settled(arrival.flight.chance).clamp_min(TINY)", "left",
           ("medium/test_closed_forms.py", "medium/test_homogeneous.py")),
    Mutant("medium/heterogeneous.py", "rest = sigma.map(lambda each: (bound - each) / (bound - control))",
           "rest = sigma.map(lambda each: (bound - each) / bound)", ("medium/test_heterogeneous.py",)),
    # Compiled code.
    Mutant("jit/lane/fused.py", "negated != second", "negated", ("jit/test_kernel_code.py",)),
    Mutant("jit/cpu/kernel_code.py", "return KernelCode(object_code(text, well), b\"\" if well",
           "return KernelCode(object_code(text, well), b\"\" if True", ("jit/test_kernel_code.py",)),
    # Ray casters.
    Mutant("raycast/every_triangle.py", 'code.both(code.compare(distance, "ogt", ZERO), code.compare(distance, "olt", end))',
           'code.compare(distance, "olt", end)', ("raycast/test_hits.py", "raycast/test_direct.py")),
    Mutant("raycast/every_triangle.py", "code.determinant(d, c), code.determinant(a, d)]", "code.determinant(d, c)]",
           ("raycast/test_direct.py",)),
    Mutant("raycast/batch.py", 'code.add(half, loaded["margin"])', "half", ("raycast/test_direct.py", "raycast")),
    Mutant("raycast/every_ball.py", "[code.dot(row, rays.d) for row in rows]", "rays.d", ("raycast/test_ball.py",)),
    Mutant("raycast/runs.py", ":3].norm(dim=2)", ":3].norm(dim=1)", ("raycast/test_ball.py",)),
    Mutant("raycast/refined.py", " + matrices[..., None, :, 3]", "", ("raycast/test_instances.py",)),
    Mutant("raycast/embree.py", "first + 1 for first in", "first for first in",
           ("raycast/test_instances.py",)),
    Mutant("raycast/warp.py", "u[lane] = hit.v", "u[lane] = hit.u", ("raycast/test_ball.py",)),
    Mutant("raycast/warp_instances.py", "wp.where(wp.max(first, second) < end, 1, 0)", "0",
           ("raycast/test_warp_instances.py",)),
)


def found_by(tree: Path, arguments: list[str], processes: int) -> str | None:
    """The first test that fails in a tree; None: all pass."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", f"-n{processes}", "--dist", "worksteal", "-p", "no:cacheprovider",
         *arguments],
        cwd=tree, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    if done.returncode in (0, 5):  # 5: these folders have no deep tests
        return None
    if done.returncode == pytest.ExitCode.USAGE_ERROR:
        raise ValueError(f"pytest cannot run {arguments}: {done.stderr}")
    failed = [line.partition(" ")[2].partition(" - ")[0] for line in done.stdout.splitlines()
              if line.startswith(("FAILED", "ERROR"))]
    return failed[0] if failed else f"exit status {done.returncode}"


def examine(mutant: Mutant, processes: int) -> str | None:
    """The test that finds a fault; None: there is none."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(shutil.copytree(ROOT, Path(folder) / "tree", ignore=LEFT_ASIDE))
        path = tree / "torch_radbp" / mutant.file
        text = path.read_text()
        if text.count(mutant.right) != 1:
            raise ValueError(f"{mutant.file} has {mutant.right!r} {text.count(mutant.right)} times")
        path.write_text(text.replace(mutant.right, mutant.wrong))
        near = [f"tests/{part}" for part in mutant.tests]
        for arguments in (near, ["--deep", *near], [], ["--deep"]):
            if found := found_by(tree, arguments, processes):
                return f"{'deep: ' * ('--deep' in arguments)}{found}"
    return None


def main() -> None:
    """Examines all, or those asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("numbers", type=int, nargs="*", help="only these, counted from 1")
    parser.add_argument("--processes", type=int, default=2, help="that run tests; 0: this one alone")
    options = parser.parse_args()
    missed = 0
    for number, mutant in enumerate(MUTANTS, 1):
        if options.numbers and number not in options.numbers:
            continue
        start = time.perf_counter()
        found = examine(mutant, options.processes)
        missed += found is None
        print(f"{number:2} {mutant.file}: {mutant.wrong!r} -> {found or 'NOT FOUND'} ({time.perf_counter() - start:.0f} s)",
              flush=True)
    sys.exit(missed > 0)


if __name__ == "__main__":
    main()
