"""Freed memory is used again, unless the environment has settings of its own for it."""

import os
import platform
import subprocess
import sys

import pytest

from torch_radbp.threads.allocator import keep_freed_memory

PROGRAM = """
import platform, resource, threading
import torch
from torch_radbp.threads.allocator import keep_freed_memory

kept = keep_freed_memory()
faults = []

def rounds(*sizes):
    for _ in range(12):  # the first few may lie side by side: an aligned block needs more room than one of its size had
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        blocks = [torch.ones(size << 18) for size in sizes]  # MiB
        del blocks
        after = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    faults.append(after - before)

torch.set_num_threads(1)
helper = threading.Thread(target=rounds, args=(40, 12, 40, 12))  # for which a helper needs two heaps
helper.start()
helper.join()
rounds(64)
print(kept, platform.libc_ver()[0] or "other", *faults)
"""


def outcome() -> tuple[bool, str, list[int]]:
    """Whether memory is kept, the C library, and pages that freed blocks take again, on a helper and on the first thread."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_TUNABLES"))}
    done = subprocess.run([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True, check=True, env=environment)
    kept, library, *pages = done.stdout.split()
    return kept == "True", library, [int(number) for number in pages]


@pytest.mark.skipif(sys.platform == "win32", reason="there are no counts of pages")
def test_freed_memory_is_used_again():
    kept, library, pages = outcome()
    assert kept == (library == "glibc") and len(pages) == 2
    assert not kept or max(pages) < 100


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
