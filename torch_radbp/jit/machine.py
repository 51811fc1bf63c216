"""Machine code from LLVM's text, for the processor that this runs on."""

from __future__ import annotations

import functools
from collections.abc import Callable
from threading import Lock
from typing import TypeVar

from llvmlite import binding as llvm

Made = TypeVar("Made")


def made_once(make: Callable[..., Made]) -> Callable[..., Made]:
    """`make` with a memory: each result is made once and kept, also if several threads ask for it at the same time.

    `functools.cache` would let each make one, and free what one of them is running.
    """
    made: dict[tuple, Made] = {}
    making = Lock()

    @functools.wraps(make, updated=())
    def remembered(*arguments) -> Made:
        if arguments not in made:
            with making:
                if arguments not in made:
                    made[arguments] = make(*arguments)
        return made[arguments]

    return remembered


@functools.cache
def host_width() -> int:
    """The number of float32 lanes in a vector of this processor: 16 with AVX-512, 8 with AVX2, 4 elsewhere."""
    features = llvm.get_host_cpu_features()
    return 16 if features.get("avx512f") else 8 if features.get("avx2") else 4


@made_once
def initialized() -> llvm.Target:
    """LLVM's target for this machine, ready for use."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


class MachineCode:
    """The functions of a module as machine code, which stays where it is as long as this object lives.

    Args:
        text: the module.
        entry: its function that lies at `address`.
    """

    def __init__(self, text: str, entry: str = "lanes_of_job"):
        machine = initialized().create_target_machine(cpu=llvm.get_host_cpu_name(),
                                                      features=llvm.get_host_cpu_features().flatten(), opt=2)
        module = llvm.parse_assembly(text)
        module.triple = machine.triple
        module.verify()
        # Of what LLVM can do beyond this, nothing made the loops faster, and compilation took twice as long.
        passes = llvm.create_new_module_pass_manager()
        passes.add_instruction_combine_pass()
        passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
        self.engine = llvm.create_mcjit_compiler(module, machine)
        self.engine.finalize_object()
        self.address = self.address_of(entry)

    def address_of(self, function: str) -> int:
        """Where a function of the module lies."""
        return self.engine.get_function_address(function)
