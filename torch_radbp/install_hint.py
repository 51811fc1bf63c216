"""How the package is installed, as all messages say it: no index has it yet, so pip is given the repository's folder.

Once an index has it, `SOURCE` becomes "torch_radbp" and `PLACE` "", and `tests/test_install_hints.py` names the pages
that still say otherwise.
"""

SOURCE = "."  # what pip installs
PLACE = " in the folder of torch_radbp's repository"  # where that is typed


def install_with(extra: str) -> str:
    """The command that installs the package with one of its extras, such as "cuda", and where it is typed."""
    return f"pip install '{SOURCE}[{extra}]'{PLACE}"
