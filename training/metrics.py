"""metrics.csv: one line per step, appended as the run goes, cut back to the checkpoint when it is resumed."""

import csv
import io
from pathlib import Path

from torch_radbp.io.atomic import replacing

COUNTS = ("step", "skipped")


class MetricsFile:
    """The table of a run's steps. Every row has the columns of the first."""

    def __init__(self, path: Path):
        self.path = path

    def rows(self) -> list[dict[str, float]]:
        """Returns the rows so far; a last line that was cut off by a crash is left out."""
        if not self.path.exists():
            return []
        text = self.path.read_text(encoding="utf-8")
        whole = text[: text.rfind("\n") + 1]
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(io.StringIO(whole))]

    def append(self, row: dict[str, float]) -> None:
        """Adds a row at once, so that a crash loses at most the step under way."""
        is_new = not self.path.exists()
        with self.path.open("a", encoding="utf-8", newline="") as file:
            _write(file, [row], header=is_new)

    def truncate(self, step: int) -> None:
        """Forgets the rows from `step` on."""
        if self.path.exists():
            rows = [row for row in self.rows() if row["step"] < step]
            with replacing(self.path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
                if rows:
                    _write(file, rows, header=True)
            if not rows:
                self.path.unlink()


def _write(file, rows: list[dict[str, float]], header: bool) -> None:
    writer = csv.DictWriter(file, rows[0], lineterminator="\n")
    if header:
        writer.writeheader()
    # repr of a float reads back as the same float, so rewriting a row changes nothing.
    for row in rows:
        writer.writerow({key: int(value) if key in COUNTS else repr(float(value)) for key, value in row.items()})
