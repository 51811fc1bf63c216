"""Kernels for GPUs that move lanes: entries put into their places or copied, flags, and numbers added to tables. One lane a
thread.

All tensors of a call are served by one kernel, which is made for their dtypes. Numbers are added to totals by atomic
operations of float64, in any order. Where a table is small, thousands of lanes would wait for each other; so it has many
copies of its totals (`scatter.copies`), of which neighbouring lanes, and so all lanes of a warp, take different ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch

from torch_radbp.jit.lane.instructions import memory
from torch_radbp.jit.nvidia.nvptx import kernel
from torch_radbp.jit.recording.addition import PAGE_BITS, SCALARS

COPIES, SMALL = 64, 1 << 10  # copies of the totals, for tables with at most so many entries

PLACE = ("%place_at = getelementptr i32, ptr %places, i64 %i", "%place32 = load i32, ptr %place_at, align 4",
         "%place = sext i32 %place32 to i64")
PUT = """\
%from{k}.at = getelementptr {type}, ptr %from{k}, i64 %i
%entry{k} = load {type}, ptr %from{k}.at, align {size}
%to{k}.at = getelementptr {type}, ptr %to{k}, i64 %place
store {type} %entry{k}, ptr %to{k}.at, align {size}"""
ADDRESS = """\
%index{k}.at = getelementptr i32, ptr %index{k}, i64 %i
%index{k}.found = load i32, ptr %index{k}.at, align 4
%number{k} = sext i32 %index{k}.found to i64
%page{k}.number = lshr i64 %number{k}, {page_bits}
%page{k} = getelementptr i8, ptr %pages{k}, i64 %page{k}.number
store i8 1, ptr %page{k}, align 1
%copy{k} = and i64 %i, %mask{k}
%copies{k} = mul i64 %number{k}, %step{k}
%place{k} = add i64 %copies{k}, %copy{k}"""
ADD = """\
%from{k}.{t}.at = getelementptr {type}, ptr %from{k}.{t}, i64 %i
%found{k}.{t} = load {type}, ptr %from{k}.{t}.at, align {size}
%wide{k}.{t} = {widened}
%to{k}.{t} = getelementptr double, ptr %totals{k}.{t}, i64 %place{k}
%before{k}.{t} = atomicrmw fadd ptr %to{k}.{t}, double %wide{k}.{t} syncscope("device") monotonic, align 8"""

COPY = """\
%from{k}.at = getelementptr {type}, ptr %from{k}, i64 %i
%entry{k} = load {type}, ptr %from{k}.at, align {size}
%to{k}.at = getelementptr {type}, ptr %to{k}, i64 %i
store {type} %entry{k}, ptr %to{k}.at, align {size}"""
# What becomes of a flag, by the name of the kernel.
MOVED = {"invert": "xor {type} %found, 1", "clear": "add {type} 0, 0"}
MOVE = """\
%from.at = getelementptr {type}, ptr %source, i64 %i
%found = load {type}, ptr %from.at, align {size}
%moved = {moved}
%to.at = getelementptr {type}, ptr %target, i64 %i
store {type} %moved, ptr %to.at, align {size}"""
# A count: what stands at an address, or, if that is null, a number.
COUNT = """\
%known{k} = icmp eq ptr %at{k}, null
br i1 %known{k}, label %next{k}, label %read{k}
read{k}:
%found{k} = load i64, ptr %at{k}, align 8
br label %next{k}
next{k}:
%count{k} = phi i64 [ %number{k}, %{before} ], [ %found{k}, %read{k} ]
%place{k} = getelementptr i64, ptr %counts, i64 {place}
store i64 %count{k}, ptr %place{k}, align 8"""


def counts_text(case: tuple[int]) -> str:
    """The LLVM IR of the kernel that writes the counts known when others begin: 0, and as many more as the case says.

    Its parameters: where they go, then of each where it stands and, if that is null, what it is.
    """
    parameters, body = ["ptr %counts"], ["store i64 0, ptr %counts, align 8"]
    for k in range(*case):
        parameters += [f"ptr %at{k}", f"i64 %number{k}"]
        body += COUNT.format(k=k, before=f"next{k - 1}" if k else "lane", place=k + 1).splitlines()
    return kernel("counts", parameters, body)


def move_text(case: tuple[str]) -> str:
    """The LLVM IR of the kernel that inverts or clears flags; its parameters: where they come from, and go to."""
    name, = case
    return kernel(name, ["ptr noalias readonly %source", "ptr noalias %target"], MOVE.format(
        type="i8", size=1, moved=MOVED[name].format(type="i8")).splitlines())


def copy_text(sizes: Sequence[int]) -> str:
    """The LLVM IR of the kernel that copies entries of so many bytes, one after the other; its parameters: where each comes
    from, and goes to.

    What was read may be written over by a later copy, at the same lane.
    """
    parameters, body = [], []
    for k, size in enumerate(sizes):
        parameters += [f"ptr %from{k}", f"ptr %to{k}"]
        body += COPY.format(k=k, type=f"i{8 * size}", size=size).splitlines()
    return kernel("copy", parameters, body)


def put_text(dtypes: Sequence[torch.dtype]) -> str:
    """The LLVM IR of the kernel that scatters entries of tensors of these dtypes.

    Its parameters: the places, then of each tensor where its entries come from and go to.
    """
    parameters = ["ptr noalias readonly %places"]
    body = list(PLACE)
    for k, dtype in enumerate(dtypes):
        parameters += [f"ptr noalias readonly %from{k}", f"ptr noalias %to{k}"]
        body += PUT.format(k=k, type=memory(dtype), size=dtype.itemsize).splitlines()
    return kernel("put", parameters, body)


def scatter_text(additions: Sequence[tuple[torch.dtype, int]]) -> str:
    """The LLVM IR of the scatter-add kernel, for dtypes of numbers and numbers of tables.

    Its parameters, of each addition: index, pages, the distance from entry to entry, the number of copies less 1, then of
    each table the numbers and the totals. Totals of several additions may be the same.
    """
    parameters, body = [], []
    for k, (dtype, tables) in enumerate(additions):
        parameters += [f"ptr readonly %index{k}", f"ptr %pages{k}", f"i64 %step{k}", f"i64 %mask{k}"]
        body += ADDRESS.format(k=k, page_bits=PAGE_BITS).splitlines()
        for t in range(tables):
            parameters += [f"ptr readonly %from{k}.{t}", f"ptr %totals{k}.{t}"]
            body += added(k, t, dtype)
    return kernel("scatter", parameters, body)


def added(k: int, t: int, dtype: torch.dtype) -> Iterator[str]:
    """Instructions by which a lane adds its number to an entry of table `t` of addition `k`, atomically."""
    number = f"%found{k}.{t}"
    widened = f"fpext float {number} to double" if dtype == torch.float32 else f"fadd double {number}, -0.0"
    yield from ADD.format(k=k, t=t, type=SCALARS[dtype], size=dtype.itemsize, widened=widened).splitlines()
