"""`radbp optimize`: a recipe in, recovered parameters and a report out."""

import warnings
from glob import escape as escape_glob
from glob import glob
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from torch_radbp.training.commands.bundled import bundled_recipes, listing, recipe_path
from torch_radbp.training.commands.clear_errors import Debug, clear_errors
from torch_radbp.training.commands.outside import AllowOutside

MOST_WEAK = 4  # correlations that are printed

EPILOG = (
    "Examples:\n\n"
    "radbp optimize cornell_reflectance  (a recipe that comes with the package; --list shows them)\n\n"
    "radbp optimize recipe.toml --out runs/bright -D render.spp=32 -D optimizer.learning_rate=0.05\n\n"
    "radbp optimize recipe.toml --steps 20  (a quick look)\n\n"
    "radbp optimize recipe.toml --out runs/bright --resume  (after Ctrl-C, or with more --steps)\n\n"
    "torchrun --nproc-per-node 2 -m torch_radbp.training.cli optimize recipe.toml  (two processes share the views, or the "
    "samples, of every step)\n\n"
    "Lines with +- have standard deviations, by derivatives at the end of the run; -D report.deviations=none leaves them "
    "out, 'all' computes them for maps within bounds, too.\n\n"
    "Ctrl-C or SIGTERM saves the state reached and writes its report; exit code 130 or 143."
)


def _show_list(wanted: bool) -> None:
    if wanted:
        print(listing())
        raise typer.Exit()


def _recipe_completion(incomplete: str) -> list[str]:
    """Returns what the Tab key offers: bundled names and recipes in files; else the shell offers files."""
    names = [name for name in bundled_recipes() if name.startswith(incomplete)]
    return names + sorted(glob(f"{escape_glob(incomplete)}*.toml"))


def optimize(
    recipe: Annotated[
        Path,
        typer.Argument(
            help="Recipe, .toml: scene, targets, parameters, losses, optimiser; or the name of a bundled one.",
            autocompletion=_recipe_completion,
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help=r"Folder of the run.  \[default: runs/NAME, numbered if it exists]")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in --out, or the last one.")] = False,
    steps: Annotated[int | None, typer.Option(help="Number of steps instead of the recipe's.")] = None,
    device: Annotated[
        str | None, typer.Option(metavar="DEVICE", help=r"cpu, cuda, or cuda:1 and so on.  \[default: the recipe's, or cpu]")
    ] = None,
    define: Annotated[
        list[str] | None,
        typer.Option("-D", "--define", metavar="KEY=VALUE", help="Set a key of the recipe, dotted: render.spp=32"),
    ] = None,
    allow_outside: AllowOutside = False,
    show_list: Annotated[
        bool, typer.Option("--list", callback=_show_list, is_eager=True, help="List the recipes that come with the package.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Recover scene parameters from images, as a recipe says."""
    with clear_errors(debug) as interrupts:
        from torch_radbp.training.ranks import joined
        from torch_radbp.training.run import run

        interrupts.check()

        options = {"steps": steps, "render.device": device}
        overrides = [*(define or []), *(f"{key}={value}" for key, value in options.items() if value is not None)]
        recipe = recipe_path(recipe)
        with joined() as ranks, warnings.catch_warnings():
            console = Console(quiet=not ranks.is_first)
            warnings.showwarning = lambda message, *_, **__: console.print(
                f"[yellow]warning:[/] {escape(str(message))}", soft_wrap=True, highlight=False
            )
            folder_path = ranks.from_first(lambda: choose_folder(recipe, out, resume))
            summary, report = run(recipe, overrides, folder_path, resume, console, interrupts, ranks, allow_outside)
    if summary is None:
        return
    console.print(recovered_table(summary))
    for line in deviations_in_words(summary):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    verdict = summary["verdict"]
    console.print(f"[bold]{verdict['word']}[/]: {verdict['explanation']}", soft_wrap=True, highlight=False)
    console.print("report:", str(report), style="bold", soft_wrap=True)
    if summary["status"] == "interrupted":
        console.print(f"stopped at step {summary['step']}; to continue: --resume --out {folder_path}", soft_wrap=True)
    if summary["status"] == "interrupted" or interrupts.received:
        raise typer.Exit(interrupts.exit_code)


def choose_folder(recipe: Path, out: Path | None, resume: bool) -> Path:
    """Returns --out, or runs/NAME: the last such folder to resume, else the first that is free.

    Raises:
        ValueError: there is no run to resume.
    """
    if out is not None:
        return out
    candidate, number = Path("runs") / recipe.stem, 1
    last = None
    while candidate.exists():
        last = candidate
        number += 1
        candidate = Path("runs") / f"{recipe.stem}-{number}"
    if not resume:
        return candidate
    if last is None:
        raise ValueError(f"--resume: there is no run of {recipe.stem!r} under runs/; name its folder with --out")
    return last


def recovered_table(summary: dict) -> Table:
    """Returns recovered values with their deviations against true ones as a rich table, one row per parameter."""
    title = f"{summary['title']}: step {summary['step']} of {summary['steps']}"
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))  # fits 80 columns
    from torch_radbp.training.report.deviations import deviations_of_parameter

    for heading in ("parameter", "recovered", "true", "error"):
        table.add_column(heading, overflow="fold")
    for each in summary["parameters"]:
        recovered = _numbers(each["recovered"]) if "recovered" in each else f"mean {each['mean']:.4f}"
        truth = _numbers(each["truth"]) if "truth" in each else "not known"
        error = "" if "largest_error" not in each else f"{each['largest_error']:.2g}"
        if "largest_error" in each and "truth" not in each:
            truth = f"mean {each['mean_truth']:.4f}"
            error = f"RMSE {each['rmse']:.2g}"
        if "chamfer" in each:
            truth, error = "a mesh", f"Chamfer {each['chamfer']:.2g}"
        if "motion" in each:
            recovered = _motion(each["motion"])
        if "pose_error" in each:
            truth = _motion(each["true_motion"])
            error += "\n{angle:.3f} deg\n{distance:.5f}".format(**each["pose_error"])
        spread = _spread(deviations_of_parameter(summary, each["name"]), "motion" in each)
        table.add_row(each["name"], recovered + spread, truth, error)
    return table


def _spread(deviations: list[float | None], is_motion: bool) -> str:
    """Returns standard deviations on lines of their own, none if there are none."""
    if not deviations:
        return ""
    words = ["not told" if each is None else f"{each:.2g}" for each in deviations]
    return f"\n+- {' '.join(words[:3])} deg\n+- {' '.join(words[3:])}" if is_motion else f"\n+- {' '.join(words)}"


def deviations_in_words(summary: dict) -> list[str]:
    """Returns what images did not tell of the recovered values, or why that is not known."""
    from torch_radbp.training.report.deviations import unsettled

    found = summary["deviations"]
    if not found["computed"]:
        return [f"no standard deviations: {found['why']}"]
    weak = found["weak"][:MOST_WEAK] + [f"{len(found['weak']) - MOST_WEAK} more"] * (len(found["weak"]) > MOST_WEAK)
    lines = [f"not told: {each}" for each in found["flat"]] + [f"correlated: {each}" for each in weak]
    lines += [f"deviations of {each['name']}: median {each['median']:.2g}, largest {each['largest']:.2g}"
              for each in found["maps"]]
    noise = f"+-: standard deviations, at a pixel noise of {found['noise']:.2g} (in {found['seconds']:.1f} s)"
    return [*lines, ". ".join([noise, *filter(None, (unsettled(summary), found["why"]))])]


def _motion(components: dict[str, float]) -> str:
    """Returns rotation vector in degrees and translation, from the initial pose, on a line each."""
    numbers = list(components.values())
    return f"from the start:\n{_numbers(numbers[:3])} deg\n{_numbers(numbers[3:])}"


def _numbers(values: list[float]) -> str:
    return " ".join(f"{value:.4f}" for value in values)
