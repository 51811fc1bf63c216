"""The installation command in messages: no index has the package yet, so pip is given the repository's folder.

Once an index has it, `SOURCE` becomes "torch_radbp" and `PLACE` "", and `tests/test_install_hints.py` names the pages
that still say otherwise.
"""

SOURCE = "."  # what pip installs
PLACE = " in the folder of torch_radbp's repository"  # where that is typed


def install_with(extra: str) -> str:
    """The command that installs the package with an extra, such as "cuda", and where to type it."""
    return f"pip install '{SOURCE}[{extra}]'{PLACE}"
