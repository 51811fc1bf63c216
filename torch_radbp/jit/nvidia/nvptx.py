"""PTX for NVIDIA GPUs, from the instructions of a block of lanes: one lane per thread.

    .entry lanes(i64 lanes, ptr first, ptr last, ptr in0, ptr in1, ..., i64 length3, ..., ptr out0, ...)

Inputs, lengths of those that are searched, and outputs are parameters of the kernel, 8 bytes each. A number of a call is
read from the device like a table: to fetch it would mean to wait for the device. So are the first lane and that after the
last, unless these pointers are null: then all `lanes` are meant. Threads beyond the last lane do nothing.

The instructions are those of `lane/emit.py` for single lanes, but for functions of float64 that the C library has elsewhere:
`lane/lowered.py` writes them out.

Which products are fused with sums is said by the program (`lane/fused.py`). Products and sums beside these are marked `.rn`,
which forbids NVIDIA's assembler to fuse them: what a kernel computes is settled by its PTX, whatever the version of the
driver, and has the bits of a processor that fuses, too.

`tests/gpu` runs them on a card. Without one it is tested that NVIDIA's assembler takes them, that the same text computes the
same on a processor, and that an interpreter of PTX finds the same in them.

Reference: NVIDIA, PTX ISA. LLVM project, User Guide for NVPTX Back-end.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from llvmlite import binding as llvm

from torch_radbp.jit.lane.emit import Body
from torch_radbp.threads.made_once import made_once

# Without a least number of blocks the assembler gives some long kernels 32 registers, and spills three times as much.
BLOCK = 128  # threads of a block; with 255 registers each, the most that a thread may have, two fit on a multiprocessor
TRIPLE = "nvptx64-nvidia-cuda"

KERNEL = """\
target triple = "{triple}"
define ptx_kernel void @{name}({parameters}) #0 {{
entry:
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %wide_block = zext i32 %block to i64
  %wide_thread = zext i32 %thread to i64
  %before = mul i64 %wide_block, {block}
  %number = add i64 %before, %wide_thread
  %all = icmp eq ptr %last, null
  br i1 %all, label %range, label %ask
ask:
  %first.found = load i64, ptr %first, align 8
  %last.found = load i64, ptr %last, align 8
  br label %range
range:
  %from = phi i64 [ 0, %entry ], [ %first.found, %ask ]
  %to = phi i64 [ %lanes, %entry ], [ %last.found, %ask ]
  %i = add i64 %from, %number
  %inside = icmp slt i64 %i, %to
  br i1 %inside, label %lane, label %done
lane:
{body}
  br label %done
done:
  ret void
}}
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
{functions}
attributes #0 = {{ nounwind "nvvm.maxntid"="{block}" "nvvm.minctasm"="1" }}
"""

LANE_PARAMETERS = "i64 %lanes", "ptr readonly %first", "ptr readonly %last"
FUSIBLE = re.compile(r"(?<=\s)(add|sub|mul)(?=\.f(?:32|64)\b)")  # by NVIDIA's assembler, since no rounding is named


def kernel(name: str, parameters: Sequence[str], body: Sequence[str], functions: Sequence[str] = ()) -> str:
    """The LLVM IR of a kernel that runs `body` for each lane `%i`.

    Args:
        name: of the kernel.
        parameters: type and name of each, 8 bytes; the lanes come before them.
        body: instructions.
        functions: that they call, defined or declared.
    """
    return KERNEL.format(triple=TRIPLE, name=name, parameters=", ".join([*LANE_PARAMETERS, *parameters]), block=BLOCK,
                         body="\n".join(f"  {line}" for line in body), functions="\n".join(functions))


def kernel_module(body: Body) -> str:
    """The LLVM IR of a program's kernel."""
    program = body.program
    parameters = [*(f"ptr noalias readonly %in{number}" for number in range(len(program.inputs))),
                  *(f"i64 %length{number}" for number in program.searched),
                  *(f"ptr noalias writeonly %out{number}" for number in range(len(program.outputs)))]
    return kernel("lanes", parameters, [*body.before, *body.block], body.functions)


@made_once
def _initialized() -> llvm.Target:
    """LLVM's target for NVIDIA GPUs, initialised.

    Raises:
        RuntimeError: if llvmlite was built without it.
    """
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    return llvm.Target.from_triple(TRIPLE)


def features(architecture: str) -> str:
    """The LLVM features for PTX ISA 8.1 (CUDA 12.1), by which a kernel may take 32 KB of parameters instead of 4."""
    return "+ptx81" if int(architecture.removeprefix("sm_")) < 100 else ""


def ptx(text: str, architecture: str) -> str:
    """Compiles LLVM IR to PTX.

    A module of one function gets few of LLVM's passes, since NVIDIA's assembler optimises the PTX again: with all of them
    compiling would take half as long again, and kernels as many registers.

    Args:
        text: LLVM's, from `kernel`.
        architecture: such as "sm_90".
    """
    machine = _initialized().create_target_machine(cpu=architecture, features=features(architecture), opt=2)
    module = llvm.parse_assembly(text)
    module.verify()
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    if "define internal" in text:
        passes = builder.getModulePassManager()
    else:
        passes = llvm.create_new_module_pass_manager()
        passes.add_instruction_combine_pass()
    passes.run(module, builder)
    return FUSIBLE.sub(r"\1.rn", machine.emit_assembly(module))
