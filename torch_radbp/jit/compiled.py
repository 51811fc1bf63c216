"""A compiled function with its calling convention, both cached on disk."""

from __future__ import annotations

import functools
import hashlib
import operator
import pickle
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import torch
from torch import Tensor

from torch_radbp.jit.arguments import Arguments, Column
from torch_radbp.jit.lane.graph import LANES, Program
from torch_radbp.jit.recording.recording import NotRecordable, Recording
from torch_radbp.jit.recording.structure import assembler
from torch_radbp.jit.store import code_cache
from torch_radbp.jit.store.fingerprint import Opaque, fingerprint
from torch_radbp.jit.target import Loop, Target
from torch_radbp.tensors import interleaved, torch_internals
from torch_radbp.threads.later import Later
from torch_radbp.threads.team import PART

UNREADABLE = (pickle.UnpicklingError, AttributeError, ImportError, EOFError, IndexError, TypeError, ValueError)


class Interface(NamedTuple):
    """The calling convention of compiled code, and how its outputs become results."""

    inputs: tuple[int, ...]  # indices of the arguments' tensors that the code reads
    searched: tuple[int, ...]  # indices of those whose lengths it needs
    dtypes: tuple[torch.dtype, ...]  # of the outputs, each computed once
    results: tuple[int, ...]  # for each returned tensor: the output number k, or ~k for the unchanged argument number k
    returned: Any  # nested tuples and lists, with a `Leaf` for each tensor
    structure: tuple  # of these, as `flatten` tells it


class Compiled:
    """A function compiled for arguments of one structure.

    Args:
        interface: of the code.
        loop: the code, ready to run; None if nothing is computed: every result is an argument as it is.
    """

    def __init__(self, interface: Interface, loop: Later[Loop] | None):
        self.interface, self.loop = interface, loop
        self.inputs, _, self.dtypes, self.results, returned, self.structure = interface
        self.assemble: Callable[[list[Tensor]], Any] = assembler(returned)
        self.sizes = [dtype.itemsize for dtype in self.dtypes]
        self.firsts = [self.results.index(k) for k in range(len(self.dtypes))]  # the first result that each output is
        self.others = [place for place, k in enumerate(self.results) if k < 0 or self.firsts[k] != place]

    def run(self, given: Arguments, outputs: list[int]) -> None:
        """Computes all lanes; writes results to the addresses `outputs`."""
        if given.lanes and self.loop is not None:
            self.loop.result().run(given.lanes, [given.pointers[place] for place in self.inputs],
                                   [given.sizes[place] for place in self.inputs], outputs)

    def takes(self, lanes: int) -> bool:
        """Counts lanes over which recorded code runs this loop; False if no better machine code will be made of it."""
        return self.loop is not None and self.loop.result().takes(lanes)

    def load(self) -> None:
        """Loads the code now instead of at the first run."""
        if self.loop is not None:
            self.loop.result()

    @property
    def address(self) -> int:
        """The address of the machine code, a C function that takes parts of a `team.Job`; waits until it is loaded."""
        address = getattr(self.loop.result(), "address", None)
        if address is None:
            raise NotRecordable("a loop is for another device")
        return address

    def recorded(self, listener: Recording, given: Arguments, outputs: Sequence[Tensor], first: int = 0) -> None:
        """Records the computation of all lanes; results go to `outputs`, from the entry `first` on."""
        if self.loop is None or not given.lanes:
            return
        if given.read is not given.leaves and any(map(operator.is_not, given.read, given.leaves)):
            raise NotRecordable("a tensor is copied before it is read")
        kinds = given.kinds
        listener.loop(self, given.lanes, PART, [given.leaves[place] for place in self.inputs], outputs,
                      first, lengths=True, of_lanes=[kinds[place] == LANES for place in self.inputs])


def code_name(function: Callable, tables: tuple[str, ...], given: Arguments, target: Target) -> str | None:
    """The name of a function's compiled code in the cache on disk: a digest of all that it depends on; None if unknown.

    Args:
        function: in plain torch.
        tables: the parameters that hold tables.
        given: arguments with the structure for which it is compiled.
        target: that it is compiled for.
    """
    structures = tuple((form.structure, *map(_plain, form.columns)) for form in given.forms)
    try:
        return fingerprint(function, tables, structures, given.shared, target.platform, compiler())
    except Opaque:
        return None


def _plain(column: Column | None) -> tuple[int, ...] | None:
    """A table's column layout as a plain tuple, for keys."""
    return None if column is None else tuple(column)


@functools.cache
def compiler() -> tuple[str, ...]:
    """The versions of all that compiled code depends on: of libraries, Python, and this package's source as a digest."""
    digest, here = hashlib.sha256(), Path(__file__).parent
    files = sorted(path for folder in (here, here.parent / "threads") for path in folder.rglob("*.py"))
    for path in (*files, Path(torch_internals.__file__), Path(interleaved.__file__)):
        digest.update(path.read_bytes())
    return str(torch.__version__), llvmlite.__version__, sys.version, digest.hexdigest()


def read_compiled(name: str, target: Target) -> Compiled | None:
    """Reads a compiled function from the cache; None if there is none."""
    found = code_cache.read_code(name)
    if found is None:
        return None
    try:
        interface, code = pickle.loads(found)
    except UNREADABLE:
        return None
    return ready(name, interface, Later(lambda: code), target)


def compiled_program(name: str | None, interface: Interface, program: Program, target: Target) -> Compiled:
    """Starts to compile a program, and writes it to the cache if it has a name."""
    def code() -> bytes:
        found = target.code(program) if interface.dtypes else b""
        if name is not None:
            write_compiled(name, interface, found)
        return found

    later = Later(code)
    if interface.dtypes:
        later.meanwhile()
    else:
        later.result()
    return ready(name, interface, later, target)


def ready(name: str | None, interface: Interface, code: Later[bytes], target: Target) -> Compiled:
    """A compiled function whose machine code is loaded at the first run, or in the background; no code without outputs."""
    keep = None if name is None else partial(write_compiled, name, interface)
    loop = Later(lambda: target.loop(code.result(), interface.searched, keep)) if interface.dtypes else None
    return Compiled(interface, loop.meanwhile() if loop is not None and target.loads_ahead else loop)


def write_compiled(name: str, interface: Interface, code: bytes) -> None:
    """Writes a compiled function to the cache, if other processes can rebuild its results."""
    try:
        contents = pickle.dumps((interface, code))
    except (pickle.PicklingError, AttributeError, TypeError):  # constants that only this process has
        return
    code_cache.write_code(name, contents)
