"""The backward sweep with a check of each bounce, to explain a gradient that is not finite."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.adjoint.bounce import DifferentiatedPart, bounce_adjoint
from torch_radbp.adjoint.local_adjoint import LocalAdjoints
from torch_radbp.adjoint.sweep import Sweep
from torch_radbp.call.finite import FirstNonFinite
from torch_radbp.path.state import Arrival, PathState
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.stage import PlainStages


class CheckedSweep(Sweep):
    """An eager backward sweep that records the first bounce, from the deepest up, with derivatives that are not finite."""

    def __init__(self, finding: FirstNonFinite, *arguments):
        super().__init__(*arguments)
        self.finding = finding

    def adjoint(self, state: PathState, depth: int) -> None:
        """Differentiates one bounce and checks that its results are finite."""

        def checked(part: DifferentiatedPart, arrival: Arrival, lanes: Tensor, *arguments):
            above, tables, adj_values = bounce_adjoint(part, arrival, lanes, *arguments)
            bad = torch.zeros_like(lanes, dtype=torch.bool)
            parts = [part for part in leaves_of((above, adj_values)) if isinstance(part, Tensor)]
            for part in [*parts, *(read.adjoint for reads in tables for read in reads)]:
                bad |= ~torch.isfinite(part)
            self.finding.look(depth, bad, arrival.hit.prim[lanes])
            return above, tables, adj_values

        self.integrand = self.integrand.with_stages(PlainStages({bounce_adjoint: checked}))
        self.local = LocalAdjoints(self.integrand, self.local.numbered)
        super().adjoint(state, depth)
