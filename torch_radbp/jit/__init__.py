"""A compiler for functions of lanes: plain torch in, one fused loop of vector instructions out.

    fused = LaneFunction(function, tables=("colours",))
    result = fused(colours, index, u)          # the first call traces and compiles, in tenths of a second

In the order of data:

1. `lane/trace.py` runs the function once on tensors without contents and notes what torch comes down to, derivatives
   included. `lane/inference.py` tells the dtypes of results, `lane/operations.py` says what each is in terms of some forty
   operations, and `lane/elementary.py` writes sin, exp, ... with them.
2. `lane/graph.py` is the program that results: values, each computed from others.
3. `lane/emit.py` writes it as LLVM's text, for vectors of any width or for single lanes; `lane/instructions.py` has the
   tables. Tables that are read at one index are read together: `lane/window.py` permutes entries that lie close to each
   other, `lane/row_reads.py` reads tables that are columns of the same rows. `cpu/prefetch.py` hints at the memory that will
   be needed.
4. `cpu/machine.py` makes machine code of that, `run.py` calls it on tensors, `threads/team.py` on several threads;
   `threads/allocator.py` has them write into memory that was used before, `cpu/large_pages.py` into pages that a processor
   finds sooner. `dual.py` has a loop compute tangents beside values, in forward mode.
5. `stages.py` runs functions that are declared as stages, compiled or in plain torch. What calls them, casts rays and moves
   lanes about, bounce after bounce, is itself noted once by a `tape.py` (`recording/recording.py`) and then run as machine
   code (`cpu/recorded.py`), whatever the numbers of lanes are; helpers take part by a `cpu/board.py`. On a GPU it is run as
   launches (`nvidia/launches.py`), whose numbers of lanes stay there (`recording/lane_count.py`, `nvidia/nvptx_order.py`).
6. `threads/later.py` has code made meanwhile, while other functions are traced: what is recorded needs none before it ends.
   `compiled.py` keeps it for later processes: on disk (`store/code_cache.py`), by what it depends on
   (`store/fingerprint.py`).

It knows torch and LLVM, and nothing of rendering.
"""

from torch_radbp.jit.lane.refusal import UnknownOperation
from torch_radbp.jit.run import LaneFunction

__all__ = ["LaneFunction", "UnknownOperation"]
