"""Runs a script of the documentation in its smallest form: few samples, pixels and steps, and without its last assertions.

Renderers run in plain torch: for so few samples compiling takes longer than all the rest.

    python -m tests.docs.quick_run docs/tutorials/01_first_gradient.py
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import torch_radbp as rb

MOST = {"spp": 2, "resolution": 24, "width": 24, "height": 24, "steps": 2, "epochs": 2, "count": 3, "max_iter": 1}  # by name
STEPS, COUNTED = 2, ("step", "epoch")  # of loops over these


class Smallest(ast.NodeTransformer):
    """Makes numbers small: of arguments, entries and defaults by their names, and of loops."""

    def visit_keyword(self, node: ast.keyword) -> ast.AST:
        node.value = limited(node.arg, node.value)
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
        """Arguments of a command, of which the number of steps is one."""
        for option, value in zip(node.elts, node.elts[1:]):
            if ast.unparse(option) == "'--steps'":
                value.value = str(STEPS)
        return self.generic_visit(node)

    def visit_For(self, node: ast.For) -> ast.AST:
        if ast.unparse(node.target) in COUNTED:
            node.iter = ast.parse(f"list({ast.unparse(node.iter)})[:{STEPS}]", mode="eval").body
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


if __name__ == "__main__":
    script = Path(sys.argv[1])
    rb.Renderer.runs_compiled = lambda renderer: False
    exec(compile(smallest(script.read_text(encoding="utf-8")), str(script), "exec"), {"__name__": "__main__"})
