"""`metrics.csv`: one line per step, appended as the run goes, cut back to the checkpoint when it is resumed."""

import csv
import io
import math
from pathlib import Path

from torch_radbp.formats.atomic import naming, replacing

COUNTS = ("step", "skipped")
NEEDED = ("step", "loss")


class MetricsFile:
    """The table of a run's steps. Every row has the columns of the first."""

    def __init__(self, path: Path):
        self.path = path

    def rows(self) -> list[dict[str, float]]:
        """Returns the rows so far; a last line that was cut off by a crash is left out.

        Raises:
            ValueError: the file is no such table; the message names the line.
        """
        if not self.path.exists():
            return []
        try:
            text = self.path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise ValueError(f"{self.path}: not a table of steps but binary; delete it, or mend it") from None
        reader = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1]))
        if reader.fieldnames is not None and not {*NEEDED} <= {*reader.fieldnames}:
            raise ValueError(f"{self.path}, line 1: a table of steps has columns {' and '.join(NEEDED)}, got "
                             f"{', '.join(reader.fieldnames)}; delete the file, or mend it")
        return [self._numbers(row, line) for line, row in enumerate(reader, start=2)]

    def _numbers(self, row: dict[str | None, str | list[str] | None], line: int) -> dict[str, float]:
        try:
            return {key: float(value) for key, value in row.items()}
        except (TypeError, ValueError):
            raise ValueError(f"{self.path}, line {line}: expected {len([*filter(None, row)])} numbers, got "
                             f"{', '.join(map(str, filter(None, row.values())))}; delete the file, or mend it") from None

    def append(self, row: dict[str, float]) -> None:
        """Adds a row at once, so that a crash loses at most the step under way."""
        is_new = not self.path.exists()
        with naming(self.path), self.path.open("a", encoding="utf-8", newline="") as file:
            _write(file, [row], header=is_new)

    def truncate(self, step: int) -> tuple[int, int]:
        """Forgets the rows from `step` on, and all but the last of each step.

        Returns:
            how many rows are left, and how many were rows of a step that has a later one.
        """
        if not self.path.exists():
            return 0, 0
        before = [row for row in self.rows() if 0 <= row["step"] < step]
        last = {row["step"]: row for row in before}
        rows = [last[each] for each in sorted(last)]
        with replacing(self.path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            if rows:
                _write(file, rows, header=True)
        if not rows:
            self.path.unlink()
        return len(rows), len(before) - len(rows)


def _write(file, rows: list[dict[str, float]], header: bool) -> None:
    writer = csv.DictWriter(file, rows[0], lineterminator="\n")
    if header:
        writer.writeheader()
    # repr of a float reads back as the same float, so rewriting a row changes nothing.
    for row in rows:
        writer.writerow({key: _text(key, value) for key, value in row.items()})


def _text(key: str, value: float) -> str:
    return str(int(value)) if key in COUNTS and math.isfinite(value) else repr(float(value))
