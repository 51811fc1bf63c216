"""One run from recipe to report: checks first, then the folder, then the steps."""

from pathlib import Path
from typing import Any

from rich.console import Console

from torch_radbp.training.interrupt import Interrupts
from torch_radbp.training.progress import TimedProgress
from torch_radbp.training.ranks import ALONE, RankError, Ranks
from torch_radbp.training.recipe import Recipe
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.checkpoint import State, load_checkpoint, save_checkpoint
from torch_radbp.training.recovery.continuation import check_state, state_bytes
from torch_radbp.training.recovery.optimize import train
from torch_radbp.training.recovery.outcome import finish, save_before
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.training.report.page import write_report


def run(
    recipe_path: Path,
    overrides: list[str],
    folder_path: Path,
    resume: bool,
    console: Console,
    interrupts: Interrupts | None = None,
    ranks: Ranks = ALONE,
    allow_outside: bool = False,
) -> tuple[dict[str, Any] | None, Path]:
    """Runs a recipe, or continues the run in `folder_path`.

    A signal (see `interrupt`) during the steps ends them, and state and report are saved as they are; during the report it
    ends the rendering of its images, which then have fewer samples.

    Args:
        recipe_path: the recipe.
        overrides: see `recipe_file.read_recipe`.
        folder_path: of the run.
        resume: continue the run that is there.
        console: what is printed on.
        interrupts: receives the signals; None: one of its own does.
        ranks: the processes that run it together; the first writes and prints, the others only take steps.
        allow_outside: take files outside of the folders of the recipe and of a glTF scene.

    Returns:
        the summary, whose "status" is "finished" or "interrupted", None of a process that is not the first; the path of the
        report.

    Raises:
        ValueError, OSError: something in the recipe or its files is wrong; nothing has been written then.
        KeyboardInterrupt: a signal came before the first step, or to another process than the first.
        RankError: another process has ended; the state reached is saved.
        FolderInUseError: another process writes into the folder.
    """
    interrupts = Interrupts() if interrupts is None else interrupts
    folder = RunFolder(folder_path)
    with interrupts:
        recipe = read_recipe(recipe_path, overrides, allow_outside)
        if resume:
            ranks.from_first(lambda: _take_folder(folder, recipe))
        try:
            recovery = Recovery(recipe, ranks, allow_outside)
            interrupts.check()
            state = ranks.from_first(lambda: _state_to_resume(folder, recovery)) if resume else None
            if not ranks.is_first:
                return _steps_alone(recovery, state, folder, interrupts), folder.report
            _begin(recovery, state, folder, recipe_path.stem, console, interrupts)
            return _steps_and_report(recovery, folder, console, interrupts)
        finally:
            folder.lock.release()


def _take_folder(folder: RunFolder, recipe: Recipe) -> None:
    """Takes the lock of the folder of a run of this recipe."""
    if not folder.checkpoint.is_file():
        raise ValueError(f"--resume: {folder.path} holds no checkpoint; start the run without --resume")
    folder.lock.acquire()
    try:
        folder.check_same_recipe(recipe)
    except BaseException:
        folder.lock.release()
        raise


def _state_to_resume(folder: RunFolder, recovery: Recovery) -> State:
    state = load_checkpoint(folder.checkpoint, state_bytes(recovery))
    check_state(folder.checkpoint, state, recovery)
    return state


def _begin(
    recovery: Recovery, state: State | None, folder: RunFolder, name: str, console: Console, interrupts: Interrupts
) -> None:
    """Writes what there is before the next step, and brings the recovery to a state."""
    with interrupts.held():
        if state is None:
            folder.start(recovery.recipe)
            save_checkpoint(folder.checkpoint, recovery.state_dict())
            name = recovery.recipe.title or name
            console.print(f"{name}: {recovery.recipe.steps} steps, writing to {folder.path}", soft_wrap=True)
        else:
            folder.save_recipe(recovery.recipe)
            folder.forget_from(state["step"])
    try:
        # Now, while the parameters have their initial values; an earlier run may have been stopped before it got here.
        if not all(folder.image_path(name, "before", ".exr").exists() for name in recovery.targets.names):
            save_before(recovery, folder)
    except KeyboardInterrupt:
        console.print(f"stopped before the first step; to continue: --resume --out {folder.path}", soft_wrap=True)
        raise
    if state is not None:
        recovery.load_state_dict(state)


def _steps_alone(recovery: Recovery, state: State | None, folder: RunFolder, interrupts: Interrupts) -> None:
    """The steps of a process that is not the first."""
    if state is not None:
        recovery.load_state_dict(state)
    train(recovery, folder, lambda row: None, interrupts)


def _steps_and_report(
    recovery: Recovery, folder: RunFolder, console: Console, interrupts: Interrupts
) -> tuple[dict[str, Any], Path]:
    status = "finished"
    try:
        with TimedProgress(console, "step", recovery.recipe.steps, recovery.step) as progress:
            train(recovery, folder, lambda row: progress.update(recovery.step, note=f"loss {row['loss']:.3e}"), interrupts)
    except KeyboardInterrupt:
        interrupts.settle()
        status = "interrupted"
    except RankError as error:
        save_checkpoint(folder.checkpoint, recovery.state_dict())
        raise RankError(f"{error}; the state after {recovery.step} steps is saved; to continue: --resume --out "
                        f"{folder.path}") from error
    finally:
        folder.close()
    with interrupts.held():
        save_checkpoint(folder.checkpoint, recovery.state_dict())
        if status == "interrupted":
            console.print(f"{interrupts.word}: the checkpoint is saved; now a report of the state reached", soft_wrap=True)
        summary = finish(recovery, folder, status, lambda: interrupts.pending)
        report = write_report(folder)
        interrupts.settle()
    return summary, report
