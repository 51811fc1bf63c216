"""`PluginCheck`: the outcome of checking a plugin, with a finding for each check."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from torch_radbp.formats.html_table import html_table


class Finding(NamedTuple):
    """The result of one check."""

    check: str  # its name, such as "density"
    agrees: bool
    figures: str  # what was measured, and what was expected where it does not agree


@dataclass(frozen=True)
class PluginCheck:
    """The results of checking a plugin, with the measured figures.

    Attributes:
        plugin: its name, such as "bsdf diffuse".
        findings: one for each check, in order: its name (`check`), whether it `agrees`, and its `figures` in words.
    """

    plugin: str
    findings: tuple[Finding, ...]

    @property
    def agrees(self) -> bool:
        """True if every check agrees."""
        return not self.failed

    @property
    def failed(self) -> tuple[str, ...]:
        """The names of the checks that do not agree."""
        return tuple(finding.check for finding in self.findings if not finding.agrees)

    @property
    def verdict(self) -> str:
        """The verdict in words: "agrees", or "disagrees" with the names of the checks."""
        return "agrees" if self.agrees else f"disagrees: {', '.join(self.failed)}"

    def __str__(self) -> str:
        width = max(len(finding.check) for finding in self.findings)
        rows = [f"  {finding.check:<{width}}  {'agrees' if finding.agrees else 'FAILS '}  {finding.figures}"
                for finding in self.findings]
        return "\n".join([self.plugin, *rows, self.verdict])

    def _repr_html_(self) -> str:
        rows = [(finding.check, "agrees" if finding.agrees else "FAILS", finding.figures) for finding in self.findings]
        return html_table(self.plugin, ("check", "", "figures"), rows, self.verdict)


def worst(check: str, cases: list[tuple[float, str]], agreed: str) -> Finding:
    """The worst result of a check that was made in several cases.

    Args:
        check: its name.
        cases: of each how far it is off, in units of what is allowed, and the figures in words.
        agreed: what to say if there was no case.
    """
    if not cases:
        return Finding(check, True, agreed)
    excess, figures = max(cases, key=lambda case: math.inf if math.isnan(case[0]) else case[0])
    return Finding(check, excess <= 1.0, figures)
