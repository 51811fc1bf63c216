"""The CPU as a target whose code is made quickly."""

from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.cpu.kernel_code import CpuLoop, KernelCode
from torch_radbp.jit.lane.graph import Program


class Quick(Cpu):
    """As `Cpu`, which makes well what is asked for by name."""

    def compile(self, program: Program) -> CpuLoop:
        return CpuLoop(KernelCode.made(self.text(program), well=False).packed())
