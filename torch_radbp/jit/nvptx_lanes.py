"""GPU kernels that move lanes: scatter entries, and add numbers to tables. One lane per thread.

All tensors of a call are served by one kernel, which is made for their dtypes. Numbers are added to totals by atomic
operations of float64, in any order. Where a table is small, thousands of lanes would wait for each other; so it has many
copies of its totals (`scatter.copies`), of which neighbouring lanes, and so all lanes of a warp, take different ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch

from torch_radbp.jit.addition import PAGE_BITS, SCALARS
from torch_radbp.jit.instructions import memory
from torch_radbp.jit.nvptx import kernel

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
    """Instructions that add to one table."""
    number = f"%found{k}.{t}"
    widened = f"fpext float {number} to double" if dtype == torch.float32 else f"fadd double {number}, -0.0"
    yield from ADD.format(k=k, t=t, type=SCALARS[dtype], size=dtype.itemsize, widened=widened).splitlines()
