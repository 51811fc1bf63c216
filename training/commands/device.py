"""The option `--device`; what it means is in `training.device`, which takes seconds to import."""

from typing import Annotated

import typer

Device = Annotated[
    str | None, typer.Option("--device", metavar="DEVICE", help=r"cpu, cuda, or cuda:1 and so on.  \[default: cpu]")
]
