"""`-D name=value`: values for the `$name` of a scene file, and options of a glTF file."""

from typing import Annotated

import typer

Define = Annotated[
    list[str] | None,
    typer.Option("-D", "--define", metavar="NAME=VALUE", help="Set $NAME of a scene file, or an option of glTF."),
]


def parse_variables(definitions: list[str] | None) -> dict[str, str]:
    """Returns {name: value} of `name=value` strings.

    Raises:
        ValueError: a string without a name or an equals sign.
    """
    variables = {}
    for definition in definitions or []:
        name, equals, value = definition.partition("=")
        if not equals or not name:
            raise ValueError(f"-D {definition!r}: expected NAME=VALUE, for instance -D resolution=64")
        if name == "allow_outside":
            raise ValueError(f"-D {definition!r}: pass --allow-outside instead")
        variables[name] = value
    return variables
