"""Runs a script of the documentation in its smallest form: few samples, pixels, bounces and steps, no last assertions.

Renderers run in plain torch: for so few samples compiling takes longer than all the rest. Commands of `radbp` run in the
process of the script.

    python -m tests.docs.quick_run docs/tutorials/01_first_gradient.py
    python -m tests.docs.quick_run     # for each line of JSON with a script and a folder a fork; prints exit statuses
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot  # noqa: F401 (what scripts import, once for all)
import torch
import trimesh.creation  # noqa: F401
from torch.autograd import forward_ad

import torch_radbp as rb
import torch_radbp.public  # noqa: F401
from torch_radbp.training import cli

RADBP = [sys.executable, "-m", "torch_radbp.training.cli"]
OUTPUT = "output.txt"  # in the folder of a script
MOST = {"spp": 2, "resolution": 16, "width": 16, "height": 16, "steps": 2, "epochs": 2, "count": 3, "max_iter": 1}  # by name
FEWEST = {"rb.check_gradient": {"batches": 8}, "rb.check_bsdf": {"samples": 10_000}}  # arguments that calls do not name
STEPS = 2
COUNTED = {"step": STEPS, "epoch": 1, "scale": 1}  # turns of loops over these
BOUNCES = 2  # of all renderers


class Smallest(ast.NodeTransformer):
    """Makes numbers small: of arguments, entries and defaults by their names, and of loops."""

    def visit_keyword(self, node: ast.keyword) -> ast.AST:
        node.value = limited(node.arg, node.value)
        return self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        given = FEWEST.get(ast.unparse(node.func), {})
        node.keywords += [ast.keyword(name, ast.Constant(value)) for name, value in given.items()]
        return self.generic_visit(node)

    def visit_Dict(self, node: ast.Dict) -> ast.AST:
        node.values = [limited(key.value, value) if isinstance(key, ast.Constant) else value
                       for key, value in zip(node.keys, node.values)]
        return self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        if isinstance(node.targets[0], ast.Name):
            node.value = limited(node.targets[0].id, node.value)
        return self.generic_visit(node)

    def visit_arguments(self, node: ast.arguments) -> ast.AST:
        named = node.args[len(node.args) - len(node.defaults):]
        node.defaults = [limited(each.arg, value) for each, value in zip(named, node.defaults)]
        return self.generic_visit(node)

    def visit_List(self, node: ast.List) -> ast.AST:
        """Arguments of a command, of which the number of steps is one, and samples of its report are."""
        for option, value in zip(node.elts, node.elts[1:]):
            if ast.unparse(option) == "'--steps'":
                value.value = str(STEPS)
            if ast.unparse(value).startswith("'report.spp="):
                value.value = f"report.spp={MOST['spp']}"
        return self.generic_visit(node)

    def visit_For(self, node: ast.For) -> ast.AST:
        if turns := COUNTED.get(ast.unparse(node.target)):
            node.iter = ast.parse(f"list({ast.unparse(node.iter)})[:{turns}]", mode="eval").body
        return self.generic_visit(node)


def limited(name: str | None, value: ast.expr) -> ast.expr:
    """A value, but a number of this name as small as it may be."""
    if name in MOST and isinstance(value, ast.Constant) and isinstance(value.value, int):
        return ast.Constant(min(value.value, MOST[name]))
    return value


def smallest(source: str) -> ast.Module:
    """A script in its smallest form."""
    tree = ast.parse(source)
    while isinstance(tree.body[-1], ast.Assert):
        tree.body.pop()
    return ast.fix_missing_locations(Smallest().visit(tree))


def run_command(command: Sequence[object], *, check: bool = False, **settings) -> subprocess.CompletedProcess:
    """`subprocess.run` of a command of `radbp`, in this process."""
    words, said, status = list(map(str, command)), io.StringIO(), 0
    assert words[:len(RADBP)] == RADBP, words
    words += ["-D", "report.deviations=none"] if "optimize" in words else []
    with contextlib.redirect_stdout(said):
        try:
            cli.app(words[len(RADBP):])
        except SystemExit as end:
            status = end.code or 0
    assert not check or status == 0, said.getvalue()
    return subprocess.CompletedProcess(words, status, said.getvalue(), "")


def run_script(script: Path) -> None:
    """Runs a script in its smallest form."""
    rb.Renderer.runs_compiled = lambda renderer: False
    make = rb.Renderer.__init__

    def make_smallest(renderer, *arguments, **settings) -> None:
        make(renderer, *arguments, **settings)
        renderer.max_depth = min(BOUNCES, renderer.max_depth % 1000)  # -1: without end

    rb.Renderer.__init__ = make_smallest
    subprocess.run = run_command
    exec(compile(smallest(script.read_text(encoding="utf-8")), str(script), "exec"), {"__name__": "__main__"})


def run_forked(script: Path, folder: Path) -> int:
    """Runs a script in a fork of this process, in a folder that gets its output; returns the exit status."""
    process = os.fork()
    if process == 0:
        os.chdir(folder)
        file = os.open(OUTPUT, os.O_WRONLY | os.O_CREAT)
        os.dup2(file, 1)
        os.dup2(file, 2)
        status = 1
        try:
            run_script(script)
            status = 0
        except BaseException:  # also of `sys.exit`
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def import_what_tangents_need() -> None:
    """Lets torch import what it imports when it meets the first tangent."""
    with forward_ad.dual_level():
        forward_ad.make_dual(torch.ones(1), torch.ones(1)) * torch.ones(1)


if __name__ == "__main__":
    import_what_tangents_need()
    if sys.argv[1:]:
        run_script(Path(sys.argv[1]))
    for line in [] if sys.argv[1:] else sys.stdin:
        print(run_forked(*map(Path, json.loads(line))), flush=True)
