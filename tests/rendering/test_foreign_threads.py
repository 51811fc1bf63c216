"""No thread of torch's OpenMP takes part in a rendering, and none spins after it.

Such threads wait by spinning, and take the cores from those that work, ours and other processes'.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.rendering.foreign_threads import TASKS

HERE = Path(__file__).parents[2]
DIFFERENTIATED_BY_AUTOGRAD = ("tape", "aovs")  # by operations that begin and end outside of our calls
pytestmark = pytest.mark.skipif(not TASKS.exists(), reason="threads are counted in Linux's /proc")


@pytest.fixture(scope="module")
def found() -> dict:
    """What `foreign_threads` prints, in a process with default settings."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("OMP_", "GOMP_", "MKL_"))}
    done = subprocess.run([sys.executable, "-m", "tests.rendering.foreign_threads"], capture_output=True, text=True,
                          cwd=HERE, env=environment, timeout=900)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", ["compiled", "eager", "vertices", "forward mode"])
def test_a_rendering_and_its_backward_pass_start_no_region(name, found):
    assert found[name] == {"threads": 0, "during": 0, "after": 0}


@pytest.mark.parametrize("name", DIFFERENTIATED_BY_AUTOGRAD)
def test_what_autograd_differentiates_leaves_none_spinning(name, found):
    assert found[name]["threads"] == 0 and found[name]["after"] < 0.1 * found["spun before"]


def test_operations_of_the_caller_leave_none_spinning(found):
    """A loss before the backward pass, as much as anything else."""
    if found["spun before"] < 1e6:
        pytest.skip("this OpenMP does not spin")
    assert found["spun after"] < 0.1 * found["spun before"]
