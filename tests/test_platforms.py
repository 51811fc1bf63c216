"""All modules are imported, and the same image comes out, where the system lacks what Windows and macOS lack."""

import json
import os
import subprocess
import sys

import pytest

from tests.deep import deep
from tests.elsewhere import render
from torch_radbp.jit.store import code_cache


@pytest.mark.parametrize("platform", ["win32", deep("darwin")])
def test_a_rendering_takes_nothing_that_only_linux_has(platform):
    environment = os.environ | {"RADBP_KERNEL_CACHE": str(code_cache.folder() or code_cache.OFF)}
    command = [sys.executable, "-m", "tests.elsewhere", platform]
    run = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == render()
