"""Compiles LLVM IR to machine code for this processor."""

from __future__ import annotations

import functools

from llvmlite import binding as llvm

from torch_radbp.jit.store import code_cache
from torch_radbp.threads.made_once import made_once


@functools.cache
def host_width() -> int:
    """The number of float32 lanes in this processor's vectors: 16 with AVX-512, 8 with AVX2, 4 elsewhere."""
    return 16 if host_features().get("avx512f") else 8 if host_features().get("avx2") else 4


@functools.cache
def host_features() -> llvm.FeatureMap:
    """This processor's instruction sets; empty where LLVM cannot tell (on some of Apple's), as its name implies them."""
    try:
        return llvm.get_host_cpu_features()
    except RuntimeError:
        return llvm.FeatureMap()


@made_once
def _initialized() -> llvm.Target:
    """LLVM's target for this processor, initialised."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


@functools.cache
def host() -> str:
    """This processor, with all that machine code for it depends on."""
    return " ".join([llvm.get_process_triple(), llvm.get_host_cpu_name(), host_features().flatten()])


def target_machine(optimizes: bool = True) -> llvm.TargetMachine:
    """LLVM's code generator for this processor."""
    return _initialized().create_target_machine(cpu=llvm.get_host_cpu_name(),
                                                features=host_features().flatten(), opt=2 if optimizes else 0)


def object_code(text: str, optimized: bool = True) -> bytes:
    """Compiles LLVM IR to machine code, an object file.

    Args:
        text: of the module.
        optimized: False for code in which no time is spent, such as that between loops: it is made ten times as quickly.
    """
    machine = target_machine(optimized)
    module = llvm.parse_assembly(text)
    module.triple = machine.triple
    module.verify()
    if optimized:
        # Of what LLVM can do beyond this, nothing made the loops faster, and compilation took twice as long.
        passes = llvm.create_new_module_pass_manager()
        passes.add_instruction_combine_pass()
        passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    return machine.emit_object(module)


class MachineCode:
    """Loaded machine code, which stays at its address as long as this object lives.

    Args:
        code: an object file, from `object_code`.
        entry: its function that lies at `address`.
    """

    def __init__(self, code: bytes, entry: str = "lanes_of_job"):
        self.engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target_machine())
        self.engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self.engine.finalize_object()
        self.address = self.address_of(entry)

    def address_of(self, function: str) -> int:
        """The address of a function of the module."""
        return self.engine.get_function_address(function)


def cached_code(text: str, entry: str = "lanes_of_job", optimized: bool = True) -> MachineCode:
    """The loaded machine code of LLVM IR, from the disk cache if possible; `optimized`: see `object_code`."""
    return MachineCode(code_cache.machine_code(text, host(), functools.partial(object_code, optimized=optimized)), entry)
