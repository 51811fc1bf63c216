"""`import torch_radbp` takes little more than `import torch`: what only some calls need is imported by them."""

import subprocess
import sys

SLOW = ("numba", "llvmlite", "scipy", "sympy", "torch._dynamo", "torch._inductor", "trimesh", "warp")


def test_the_package_imports_no_compiler_and_no_mesh_library():
    program = f"import sys, torch_radbp; print([name for name in {SLOW} if name in sys.modules])"
    output = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "[]"

