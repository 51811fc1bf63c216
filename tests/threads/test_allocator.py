"""Freed memory is used again, unless the environment has settings of its own for it."""

import os
import platform
import subprocess
import sys

import pytest

from torch_radbp.threads.allocator import keep_freed_memory

PROGRAM = """
import platform, resource, sys, threading
import torch
from torch_radbp.threads.allocator import keep_freed_memory

sizes = [int(size) << 20 for size in sys.argv[2:]]
kept = keep_freed_memory()
faults = []

def rounds():
    for _ in range(12):  # the first few may lie side by side: an aligned block needs more room than one of its size had
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        blocks = [torch.ones(size // 4) for size in sizes]
        del blocks
        faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)

if sys.argv[1] == "helper":
    torch.set_num_threads(1)
    helper = threading.Thread(target=rounds)
    helper.start()
    helper.join()
else:
    rounds()
print(kept, platform.libc_ver()[0] or "other", faults[-1])
"""
WHOLE = "main", "64"  # one block of 64 MiB, on the first thread


def outcome(*blocks: str) -> tuple[bool, str, int]:
    """Whether memory is kept, the C library, and how many pages blocks take that were just freed.

    Args:
        blocks: the thread, "main" or "helper", and their sizes in MiB.
    """
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_TUNABLES"))}
    done = subprocess.run([sys.executable, "-c", PROGRAM, *blocks], stdout=subprocess.PIPE, text=True, check=True,
                          env=environment)
    kept, library, pages = done.stdout.split()
    return kept == "True", library, int(pages)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no counts of pages")
@pytest.mark.parametrize("blocks", [WHOLE, ("helper", "40", "12", "40", "12")])  # of which a helper needs two heaps
def test_freed_memory_is_used_again(blocks):
    kept, library, pages = outcome(*blocks)
    assert kept == (library == "glibc")
    assert not kept or pages < 100


@pytest.mark.skipif(sys.platform != "linux", reason="these are settings of the GNU C library")
@pytest.mark.parametrize("setting", ["MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES"])
def test_settings_of_the_environment_are_left_alone(setting, monkeypatch):
    for name in [name for name in os.environ if name.startswith(("MALLOC_", "GLIBC_TUNABLES"))]:
        monkeypatch.delenv(name)
    ask = keep_freed_memory.__wrapped__  # each time
    assert ask() == (platform.libc_ver()[0] == "glibc")
    value = {"MALLOC_TRIM_THRESHOLD_": "100000", "GLIBC_TUNABLES": "glibc.malloc.trim_threshold=100000"}[setting]
    monkeypatch.setenv(setting, value)
    assert not ask()
