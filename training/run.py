"""One run from recipe to report: checks first, then the folder, then the steps."""

import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from torch_radbp.training.optimize import Recovery, train
from torch_radbp.training.outcome import finish, save_before
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.report import write_report
from torch_radbp.training.run_folder import RunFolder

# Where there is no terminal to draw a bar on, a line is printed about this often.
LINES_WITHOUT_TERMINAL = 20


def run(
    recipe_path: Path, overrides: list[str], folder_path: Path, resume: bool, console: Console
) -> tuple[dict[str, Any], Path]:
    """Runs a recipe, or continues the run in `folder_path`.

    Returns:
        the summary, whose "status" is "finished" or "interrupted"; the path of the report.

    Raises:
        ValueError, OSError: something in the recipe or its files is wrong; nothing has been written then.
    """
    folder = RunFolder(folder_path)
    recipe = read_recipe(recipe_path, overrides)
    if resume and not folder.has_checkpoint():
        raise ValueError(f"--resume: {folder_path} holds no checkpoint; start the run without --resume")
    if resume:
        folder.check_same_recipe(recipe)
    recovery = Recovery(recipe)
    state = folder.load_checkpoint() if resume else None
    if state is None:
        folder.start(recipe)
        folder.save_checkpoint(recovery.state_dict())
        name = recipe.title or recipe_path.stem
        console.print(f"{name}: {recipe.steps} steps, writing to {folder_path}", soft_wrap=True)
    elif state["step"] > recipe.steps:
        raise ValueError(f"--resume: the run is at step {state['step']} already, beyond steps = {recipe.steps}")
    # Now, while the parameters have their initial values; an earlier run may have been stopped before it got here.
    if not all(folder.image_path(name, "before").exists() for name in recovery.targets.names):
        save_before(recovery, folder)
    if state is not None:
        folder.save_recipe(recipe)
        folder.metrics.truncate(state["step"])
        recovery.load_state_dict(state)

    status = "finished"
    try:
        _train_with_progress(recovery, folder, console)
    except KeyboardInterrupt:
        status = "interrupted"
        console.print("stopping: saving the checkpoint and a report of the state reached")
    finally:
        folder.close()
    folder.save_checkpoint(recovery.state_dict())
    summary = finish(recovery, folder, status)
    return summary, write_report(folder)


def _train_with_progress(recovery: Recovery, folder: RunFolder, console: Console) -> None:
    steps = recovery.recipe.steps
    every = max(1, steps // LINES_WITHOUT_TERMINAL)
    with Progress(
        TextColumn("step"), MofNCompleteColumn(), BarColumn(), TextColumn("loss {task.fields[loss]}"),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), console=console, transient=True,
        disable=not console.is_terminal,
    ) as progress:  # fmt: skip
        task = progress.add_task("", total=steps, completed=recovery.step, loss="...")
        started, first = time.perf_counter(), recovery.step

        def on_step(row: dict[str, float]) -> None:
            done = int(row["step"]) + 1
            progress.update(task, completed=done, loss=f"{row['loss']:.3e}")
            if not console.is_terminal and done % every == 0:
                left = (time.perf_counter() - started) / (done - first) * (steps - done)
                console.print(f"step {done}/{steps}  loss {row['loss']:.3e}  {left:.0f} s left")

        train(recovery, folder, on_step)
