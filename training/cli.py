"""The console script `radbp`."""

from typing import Annotated

import typer

from torch_radbp.training.commands.cache import EPILOG as CACHE_EPILOG
from torch_radbp.training.commands.cache import cache
from torch_radbp.training.commands.check import EPILOG as CHECK_EPILOG
from torch_radbp.training.commands.check import check
from torch_radbp.training.commands.doctor import EPILOG as DOCTOR_EPILOG
from torch_radbp.training.commands.doctor import doctor
from torch_radbp.training.commands.info import EPILOG as INFO_EPILOG
from torch_radbp.training.commands.info import info
from torch_radbp.training.commands.optimize import EPILOG as OPTIMIZE_EPILOG
from torch_radbp.training.commands.optimize import optimize
from torch_radbp.training.commands.render import EPILOG as RENDER_EPILOG
from torch_radbp.training.commands.render import render

EPILOG = (
    "Examples:\n\n"
    "radbp info scene.xml  (what is in a scene, and what its parameters are called)\n\n"
    "radbp render scene.xml -o image.png --spp 64\n\n"
    "radbp optimize recipe.toml --out runs/first  (recover parameters from images)\n\n"
    "radbp check scene.xml --param white.reflectance.value  (is a derivative right?)\n\n"
    "radbp doctor  (what is installed, and what is missing)\n\n"
    "Every command explains itself: radbp render --help. Completion by the Tab key: radbp --install-completion"
)

app = typer.Typer(
    help="torch_radbp: render Mitsuba 3 scenes and glTF assets, and recover materials and lights from images.",
    epilog=EPILOG,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command(epilog=RENDER_EPILOG)(render)
app.command(epilog=INFO_EPILOG)(info)
app.command(epilog=OPTIMIZE_EPILOG)(optimize)
app.command(epilog=CHECK_EPILOG)(check)
app.command(epilog=CACHE_EPILOG)(cache)
app.command(epilog=DOCTOR_EPILOG)(doctor)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"torch_radbp {version('torch_radbp')}")
        raise typer.Exit()


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Entry point of the console script."""
    app()


if __name__ == "__main__":
    main()
