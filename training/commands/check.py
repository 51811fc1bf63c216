"""`radbp check`: is the derivative with respect to a parameter right? A table, pictures and a verdict."""

import json
import math
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from torch_radbp.training.commands.clear_errors import Debug, clear_errors
from torch_radbp.training.commands.device import Device
from torch_radbp.training.commands.outside import AllowOutside
from torch_radbp.training.commands.render import chosen_sensors
from torch_radbp.training.commands.scene_variables import Define, parse_variables
from torch_radbp.training.progress import TimedProgress

BIASED_CODE, NOTHING_FOUND_CODE = 1, 3
SHOWN_Z = 5.0  # standard errors at the ends of the colour bar

EPILOG = (
    "Examples:\n\n"
    "radbp check scene.xml --param white.reflectance.value\n\n"
    "radbp check scene.xml --param white.reflectance.value --direction 1,0,0 --spp 1024  (red only, less noise)\n\n"
    "radbp check scene.xml --param wall.bsdf.reflectance.data --direction change.npy --step 0.1\n\n"
    "Finite differences are rendered with samples of their own, and never outside of the parameter's range. The verdict is "
    "'agrees' (exit code 0), 'biased' (1), or says that nothing could be found out (3): 'too noisy', with the number of "
    "samples that would do, 'too large a step', with a smaller one, or 'at a floor', with the least value that can be "
    "checked; wrong input is exit code 2. In the folder of --out: "
    "check.png with finite differences, forward mode, their difference and that in standard errors, blue below zero and red "
    "above; and check.json with all figures. With several sensors there is a picture for each.\n\n"
    "How far do images tell parameters, before any photograph is taken or any run is made?\n\n"
    "radbp check scene.xml --covariance --param white.reflectance.value --param light.emitter.radiance.value\n\n"
    "radbp check recipe.toml --covariance  (its parameters at their initial values, by the cameras of its targets)\n\n"
    "It prints the standard deviation of every number, by derivatives in forward mode; pairs that are correlated by more "
    "than 0.8, which are known together better than apart; and what is 'not told': what no pixel shows, or what shows only "
    "as a product, ratio or sum. Then take another view or lamp, hold one of them fixed, or put something known into the "
    "scene. What images tell by less than 3 standard errors of the derivatives is not told, either: a larger --spp may. A "
    "matrix is computed for up to 200 numbers.\n\n"
    "radbp info scene.xml lists the names of the parameters."
)


def check(
    scene: Annotated[
        Path, typer.Argument(help="Scene: Mitsuba 3 .xml, or glTF .glb or .gltf; with --covariance also a recipe, .toml")
    ],
    param: Annotated[
        list[str] | None,
        typer.Option(help="Name of the parameter, as radbp info shows it; with --covariance it may be repeated."),
    ] = None,
    direction: Annotated[
        str | None,
        typer.Option(help="How it moves: ones, random, numbers such as 1,0,0, or an array in a .npy file, of its shape.  "
                     r"\[default: random; 1 for a number]", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help=r"Folder of pictures and figures.  \[default: runs/checks/PARAM]")
    ] = None,
    spp: Annotated[
        int | None,
        typer.Option(help=r"Samples per pixel of each derivative.  \[default: 256; the recipe's]", show_default=False),
    ] = None,
    max_depth: Annotated[
        int | None, typer.Option(help=r"1 = emission, 2 = direct light, -1 = unlimited.  \[default: the scene's]")
    ] = None,
    rr_depth: Annotated[int | None, typer.Option(help=r"Where roulette begins.  \[default: the scene's]")] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same verdict.", min=0)] = 0,
    step: Annotated[
        float | None,
        typer.Option(help=r"Of the finite differences, in units of the direction.  \[default: 2 % of the parameter]"),
    ] = None,
    batches: Annotated[int, typer.Option(help="Repetitions that give the standard errors; at least 8.")] = 16,
    sensor: Annotated[list[str] | None, typer.Option(help=r"Name of a sensor; may be repeated.  \[default: all]")] = None,
    covariance: Annotated[
        bool, typer.Option("--covariance", help="Say how far images tell the parameters, not whether derivatives are right.")
    ] = False,
    noise: Annotated[
        float | None,
        typer.Option(help=r"With --covariance: standard deviation of a pixel.  \[default: 1 % of the mean pixel]",
                     show_default=False),
    ] = None,
    device: Device = None,
    define: Define = None,
    allow_outside: AllowOutside = False,
    debug: Debug = False,
) -> None:
    """Compare a derivative with finite differences of independent samples; or say how far images tell parameters."""
    console = Console()
    if covariance:
        with clear_errors(debug):
            only = {"--direction": direction, "--out": out, "--step": step}
            given = [name for name, value in only.items() if value is not None]
            if given:
                raise ValueError(f"{given[0]} does not go with --covariance, which writes nothing and needs no differences")
            told = covariance_told(scene, param or [], sensor, noise, spp, seed, (max_depth, rr_depth, device, define,
                                                                                 allow_outside))
        from torch_radbp.training.commands.check_covariance import print_told

        print_told(console, told)
        return
    with clear_errors(debug):
        import torch_radbp as rb
        from torch_radbp.training.device import usable_device
        from torch_radbp.training.recovery.targets import sensor_films

        loaded = rb.load(scene, allow_outside=allow_outside, **parse_variables(define)).to(usable_device(device))
        indices = chosen_sensors(sensor, list(sensor_films(loaded)))
        if noise is not None or len(param or []) != 1:
            raise ValueError("--noise goes with --covariance" if noise is not None else
                             f"name one parameter by --param, got {len(param or [])}; several go with --covariance")
        param, spp = param[0], 256 if spp is None else spp
        moves = parse_direction(direction, tuple(loaded.get_parameter(param).shape))
        folder = Path("runs") / "checks" / param if out is None else out
        if folder.exists() and not folder.is_dir():
            raise ValueError(f"--out {folder}: is a file; name a folder")
        with TimedProgress(Console(stderr=True), "rendering", None) as progress:
            result = rb.check_gradient(
                loaded, param, direction=moves, spp=spp, seed=seed, step=step, sensors=list(indices.values()),
                batches=batches, max_depth=max_depth, rr_depth=rr_depth, progress=progress.update,
            )  # fmt: skip
        pictures = write_outcome(folder, result, list(indices))
    print_outcome(console, result)
    for path in (*pictures, folder / "check.json"):
        console.print("written:", str(path), soft_wrap=True)
    if not result.agrees:
        raise typer.Exit(BIASED_CODE if result.verdict.startswith("biased") else NOTHING_FOUND_CODE)


def covariance_told(scene: Path, names: list[str], sensor: list[str] | None, noise: float | None, spp: int | None, seed: int,
                    settings: tuple):
    """What images tell of parameters, `check_covariance.Told`; `settings`: depths, device, variables, outside files.

    Raises:
        ValueError: options that a recipe has of its own, no parameter of a scene, noise that is not positive.
    """
    import torch_radbp as rb
    from torch_radbp.training.commands.check_covariance import told_by_recipe, told_by_scene
    from torch_radbp.training.device import usable_device
    from torch_radbp.training.recovery.targets import sensor_films

    max_depth, rr_depth, device, define, allow_outside = settings
    if scene.suffix == ".toml":
        own = {"--param": names, "--sensor": sensor, "--max-depth": max_depth, "--rr-depth": rr_depth, "--device": device,
               "--define": define}
        given = [name for name, value in own.items() if value]
        if given:
            raise ValueError(f"{given[0]} is for scenes; a recipe says that itself")
        return told_by_recipe(scene, noise, spp, seed, allow_outside)
    if not names:
        raise ValueError("--covariance of a scene needs a --param, or several; radbp info lists their names")
    loaded = rb.load(scene, allow_outside=allow_outside, **parse_variables(define)).to(usable_device(device))
    indices = chosen_sensors(sensor, list(sensor_films(loaded)))
    renderer = rb.Renderer(loaded, max_depth=max_depth, rr_depth=rr_depth)
    return told_by_scene(renderer, names, list(indices.values()), noise, 256 if spp is None else spp, seed)


def parse_direction(text: str | None, shape: tuple[int, ...]):
    """Returns --direction as `check_gradient` takes it: None, a word, or an array of the parameter's shape.

    Raises:
        ValueError: neither a word, nor numbers, nor an array of the right shape.
    """
    import numpy as np

    from torch_radbp.check.gradient import DIRECTIONS

    if text is None or text in DIRECTIONS:
        return text
    if text.endswith(".npy"):
        if not Path(text).is_file():
            raise ValueError(f"--direction {text}: no such file")
        array = np.load(text, allow_pickle=False)
    else:
        try:
            array = np.array([float(number) for number in text.split(",")])
        except ValueError:
            raise ValueError(
                f"--direction {text}: expected {', '.join(DIRECTIONS)}, numbers such as 1,0,0, or a file that ends in .npy"
            ) from None
        array = array.reshape(shape) if array.size == int(np.prod(shape)) else array
    if array.shape != shape:
        raise ValueError(f"--direction {text}: must have the parameter's shape {shape}, got {array.shape}")
    return array


def write_outcome(folder: Path, result, sensors: list[str]) -> list[Path]:
    """Writes one picture per sensor and check.json into `folder`; returns the paths of the pictures."""
    from torch_radbp.formats.atomic import replacing
    from torch_radbp.formats.file_names import file_name
    from torch_radbp.training.signed_picture import write_panels

    folder.mkdir(parents=True, exist_ok=True)
    names = ["check.png"] if len(sensors) == 1 else [f"check_{file_name(name)}.png" for name in sensors]
    for number, name in enumerate(names):
        write_panels(folder / name, panels(result, number))
    figures = result.figures() | {"sensors": sensors, "direction": result.direction.tolist()}
    with replacing(folder / "check.json") as partial:
        partial.write_text(json.dumps(_finite(figures), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return [folder / name for name in names]


def _finite(value):
    """Returns what JSON can hold: None instead of numbers that are NaN or infinite."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def panels(result, number: int) -> list:
    """Returns the four pictures of one sensor: means over the channels, and the z of the channel that is worst."""
    from torch_radbp.training.false_colour import error_scale
    from torch_radbp.training.signed_picture import Panel

    comparison = result.comparison
    difference, jvp = comparison.difference[number].mean(0), comparison.jvp[number].mean(0)
    z = comparison.z[number]
    worst = z.gather(0, z.abs().argmax(0, keepdim=True))[0]
    scale = max(error_scale(image.abs()[None]) for image in (difference, jvp))
    error = jvp - difference
    return [
        Panel("finite differences", difference, scale),
        Panel("forward mode (JVP)", jvp, scale),
        Panel("JVP - differences", error, error_scale(error.abs()[None])),
        Panel("the same in standard errors", worst, SHOWN_Z),
    ]


def print_outcome(console: Console, result) -> None:
    """Prints the table of projections, the other figures and the verdict."""
    headings, *rows = result.rows()
    settings = f"step {result.step:.3g}, {result.spp} samples per pixel in {result.batches} batches"
    console.print(f"[bold]{result.name}[/]: {settings}", soft_wrap=True, highlight=False)
    table = Table(box=None, padding=(0, 2, 0, 0))
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console.print(table)
    for label, value in result.summary():
        console.print(f"{label}: {value}", soft_wrap=True, highlight=False)
    colour = "green" if result.agrees else "red" if result.verdict.startswith("biased") else "yellow"
    console.print(f"[bold {colour}]{result.verdict}[/]: {result.explanation}", soft_wrap=True, highlight=False)
