"""Progress of long jobs with elapsed and remaining time: a bar on a terminal, elsewhere a line now and then."""

import time
from collections.abc import Callable

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

# Without a terminal a line is printed after so many seconds, and then so often in the whole expected time at most.
FIRST_LINE, LINES = 10.0, 20


class TimedProgress:
    """The progress of one job; a context manager.

    Args:
        console: where it is shown.
        job: what is being done, in a word or two.
        total: the amount of work, in any unit; None: not yet known.
        done: what an earlier run has done already.
        clock: returns seconds.
    """

    def __init__(
        self, console: Console, job: str, total: int | None, done: int = 0, clock: Callable[[], float] = time.monotonic
    ):
        self.console, self.job, self.clock = console, job, clock
        self.total, self.done, self.first = total, done, done
        self.started = self.printed = clock()
        self.bar = Progress(
            TextColumn("{task.description}"), MofNCompleteColumn(), BarColumn(),
            TextColumn("{task.fields[note]}"), TimeElapsedColumn(), TextColumn("elapsed,"), TimeRemainingColumn(),
            TextColumn("left"), console=console, transient=True, disable=not console.is_terminal,
        )  # fmt: skip
        self.task = self.bar.add_task(job, total=total, completed=done, note="")

    def __enter__(self) -> "TimedProgress":
        self.bar.start()
        return self

    def __exit__(self, *_) -> None:
        self.bar.stop()

    def update(self, done: int, total: int | None = None, note: str = "") -> None:
        """Shows that `done` of `total` is done, with a note; the total may be left out where it has not changed."""
        self.done, self.total = done, self.total if total is None else total
        self.bar.update(self.task, completed=done, total=self.total, note=note)
        if self.console.is_terminal or not self.total:
            return
        elapsed = self.clock() - self.started
        left = elapsed / max(1, done - self.first) * (self.total - done)
        if self.clock() - self.printed >= max(FIRST_LINE, (elapsed + left) / LINES):
            self.printed = self.clock()
            parts = [f"{self.job} {done}/{self.total}", note, f"{duration(elapsed)} elapsed, {duration(left)} left"]
            self.console.print("  ".join(filter(None, parts)), soft_wrap=True, highlight=False)


def duration(seconds: float) -> str:
    """Returns a time as people say it: `48.1 s`, `6 min 02 s`, `2 h 05 min`."""
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
