"""The package on a system that looks like another one: `python -m tests.elsewhere win32` or `... darwin`.

What the package imports is imported before, since that runs on the system it was built for. Then `os`, `sys` and `ctypes`
are replaced by modules that lack what the other system lacks, all modules of the package are imported, and a box is rendered
with a gradient on two threads; its pixels and its gradient are printed as JSON.
"""

from __future__ import annotations

import ast
import ctypes
import importlib
import importlib.util
import json
import os
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import torch

PACKAGE = Path(__file__).parent.parent / "torch_radbp"
TRAINING = PACKAGE.parent / "training"
ROOMS = PACKAGE.parent / "assets" / "cornell_box" / "scene.xml"


class Other(NamedTuple):
    """What a system has not, or has otherwise."""

    name: str  # os.name
    modules: tuple[str, ...]  # not in its standard library
    own_modules: tuple[str, ...]  # in its alone
    functions: tuple[str, ...]  # not in its `os`
    c_library: str | None  # what ctypes.CDLL takes for the C library


NOT_ON_MACOS = ("sched_getaffinity", "sched_setaffinity", "sched_setscheduler", "sched_getscheduler", "memfd_create",
                "sysconf_names", "posix_fadvise", "posix_fallocate", "copy_file_range", "pidfd_open", "splice", "O_TMPFILE",
                "O_DIRECT", "getresuid", "eventfd", "unshare")
NOT_ON_WINDOWS = (*NOT_ON_MACOS, "getuid", "geteuid", "getgid", "getegid", "getgroups", "sysconf", "confstr", "fork",
                  "forkpty", "register_at_fork", "getloadavg", "uname", "killpg", "getpgid", "getpgrp", "setsid", "setpgid",
                  "nice", "getpriority", "setpriority", "sched_yield", "statvfs", "fstatvfs", "mkfifo", "mknod", "chown",
                  "fchown", "lchown", "chroot", "wait3", "wait4", "pread", "pwrite", "preadv", "pwritev", "sync",
                  "fdatasync", "openpty", "posix_spawn", "sendfile", "O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW",
                  "O_NONBLOCK", "O_SYNC", "WNOHANG")
OTHERS = {
    "win32": Other("nt", ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "posix", "syslog", "readline"),
                   ("msvcrt",), NOT_ON_WINDOWS, "msvcrt"),
    "darwin": Other("posix", ("spwd", "ossaudiodev"), (), NOT_ON_MACOS, None),
}


class Stub(ModuleType):
    """A module with some names missing and some of another value."""

    def __init__(self, original: ModuleType, missing: tuple[str, ...] = (), **changed: Any):
        super().__init__(original.__name__)
        self.__dict__.update({name: value for name, value in vars(original).items() if name not in missing} | changed)


def files() -> Iterator[tuple[str, Path]]:
    """The modules of the package and of its command line, by name."""
    for folder, package in ((PACKAGE, "torch_radbp"), (TRAINING, "torch_radbp.training")):
        for path in sorted(folder.rglob("*.py")):
            parts = (package, *path.relative_to(folder).with_suffix("").parts)
            yield ".".join(parts).removesuffix(".__init__"), path


def imported_from_others(path: Path) -> set[str]:
    """The modules of others that a file imports, those inside functions included."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return {name for name in names if name.split(".")[0] != "torch_radbp"}


def import_others(absent: tuple[str, ...]) -> None:
    """Imports all that the package needs, except what the other system lacks."""
    for name in sorted(set().union(*(imported_from_others(path) for _, path in files())) - set(absent)):
        if importlib.util.find_spec(name.split(".")[0]) is not None:
            importlib.import_module(name)


def become(platform: str) -> None:
    """Replaces what differs on the other system."""
    from llvmlite import binding as llvm

    other = OTHERS[platform]
    import_others(other.modules)
    sysconfig.get_config_vars()  # read once, from a module that is named after the platform
    sys.modules |= dict.fromkeys(other.modules) | {name: ModuleType(name) for name in other.own_modules}
    sys.modules["os"] = Stub(os, other.functions, name=other.name)
    sys.modules["sys"] = Stub(sys, platform=platform)
    sys.modules["ctypes"] = Stub(ctypes, CDLL=library_of(other))
    llvm.get_host_cpu_features = features_unknown


def library_of(other: Other) -> type[ctypes.CDLL]:
    """ctypes.CDLL of the other system: a C library of its own name, and nothing of OpenMP and MKL in torch's library."""

    class Library(ctypes.CDLL):
        def __init__(self, name: str | None = None, *arguments, **options):
            if name is None and other.c_library is not None:
                raise TypeError("bad argument type for built-in operation")
            super().__init__(None if name == other.c_library else name, *arguments, **options)

        def __getattr__(self, name: str):
            if name.startswith(("GOMP_", "omp_", "MKL_")):
                raise AttributeError(f"function {name!r} not found")
            return super().__getattr__(name)

    return Library


def features_unknown():
    """As llvmlite's function where LLVM does not know the processor, which was so for Apple's."""
    raise RuntimeError("failed to get host cpu features.")


def render() -> dict[str, list]:
    """A rendering, and a derivative."""
    import torch_radbp as rb

    scene = rb.load(ROOMS, resolution=16)
    green = scene.get_parameter("green.reflectance.value").requires_grad_()
    image = rb.render(scene, spp=4, seed=1, max_depth=3, chunk=512, caster="embree")
    image.mean().backward()
    return {"image": image.flatten().tolist(), "gradient": green.grad.tolist()}


if __name__ == "__main__":
    if sys.argv[1] in OTHERS:
        become(sys.argv[1])
    for module, _ in files():
        importlib.import_module(module)
    torch.set_num_threads(2)
    print(json.dumps(render()))
