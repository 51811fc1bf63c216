"""The rows of `benchmarks.media_derivatives`: nothing is left out, and a wrong gradient is called wrong."""

import torch

from tests.medium.differences import Comparison
from tests.scenes.media_rows import BOUNDARIES, LIGHTS, MEDIA, PARAMETERS, PHASES, rows, scene_of
from torch_radbp.plugin import REGISTRY


def types(described: dict) -> set[str]:
    """The types of all plugins in a description."""
    found = {described["type"]} if "type" in described else set()
    return found.union(*(types(value) for value in described.values() if isinstance(value, dict)))


def test_every_medium_phase_function_and_emitter_has_a_row():
    used = set().union(*(types(scene_of(row)) for row in rows()))
    for category in ("medium", "phase", "emitter"):
        assert set(REGISTRY[category]) - {"attributes"} <= used, category


def test_every_piece_has_a_row():
    for field, pieces in {"medium": MEDIA, "phase": PHASES, "light": LIGHTS, "parameter": PARAMETERS,
                          "boundary": BOUNDARIES}.items():
        assert set(pieces) <= {getattr(row, field) for row in rows()}, field


def test_rows_differ_and_are_as_many_as_promised():
    names = [str(row) for row in rows()]
    assert len(names) == len(set(names)) >= 90


def compared(gradient, error: float) -> Comparison:
    difference = torch.tensor([1.0, -2.0, 2.0])
    return Comparison(torch.tensor(gradient), difference, torch.full((3,), error), torch.zeros(3))


def test_verdicts_follow_error_noise_and_the_worst_entry():
    assert compared([1.0, -2.0, 2.1], 0.02).verdict == "**wrong**"  # 5 standard errors, 3.3 %
    assert compared([1.0, -2.0, 2.06], 0.01).verdict == "right"  # 6 standard errors, 2 %
    assert compared([1.0, -2.0, 2.12], 0.04).verdict == "within 3.5 standard errors"  # 3 of them, 4 %
    assert compared([1.0, -2.0, 2.0], 0.1).verdict == "not known"
    assert compared([1.0, -2.0, torch.nan], 0.01).verdict == "**not finite, or zero**"
    assert 3.7 < compared([1.0, -2.0, 2.0], 0.1).bound < 3.9
