"""`--allow-outside`: files outside of the folder of what names them."""

from typing import Annotated

import typer

AllowOutside = Annotated[
    bool,
    typer.Option("--allow-outside", help="Also read files outside of the folder of the recipe, or of a glTF scene."),
]
