"""Every fault of `tests/mutants.py` can be put in: what it replaces stands in its file, once."""

import pytest

from tests.mutants import MUTANTS, ROOT


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: f"{mutant.file}: {mutant.wrong}")
def test_what_a_fault_replaces_stands_there_once(mutant):
    assert (ROOT / "torch_radbp" / mutant.file).read_text().count(mutant.right) == 1
    assert mutant.right != mutant.wrong and all((ROOT / "tests" / part).exists() for part in mutant.tests)
