"""Freed memory is used again, unless the environment has settings of its own for it."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import platform, resource
import torch
from torch_radbp.jit.allocator import keep_freed_memory

kept = keep_freed_memory()
faults = []
for _ in range(12):  # the first few may lie side by side: an aligned block needs more room than one of its size had
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.ones(1 << 24).sum()
    faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
print(kept, platform.libc_ver()[0] or "other", faults[-1])
"""


def outcome(**settings: str) -> tuple[bool, str, int]:
    """Whether memory is kept, the C library, and how many pages 64 MB take that were just freed."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_TUNABLES"))}
    done = subprocess.run([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True, check=True,
                          env=environment | settings)
    kept, library, pages = done.stdout.split()
    return kept == "True", library, int(pages)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no counts of pages")
def test_freed_memory_is_used_again():
    kept, library, pages = outcome()
    assert kept == (library == "glibc")
    assert not kept or pages < 100


@pytest.mark.skipif(sys.platform != "linux", reason="these are settings of the GNU C library")
@pytest.mark.parametrize("setting", ["MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES"])
def test_settings_of_the_environment_are_left_alone(setting):
    value = {"MALLOC_TRIM_THRESHOLD_": "100000", "GLIBC_TUNABLES": "glibc.malloc.trim_threshold=100000"}[setting]
    assert not outcome(**{setting: value})[0]
