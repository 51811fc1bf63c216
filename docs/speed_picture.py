"""Draws assets/pictures/speed.png, bars of the seconds to equal error, from the table of docs/evidence_speed.md.

    python -m docs.speed_picture     # after that table has changed
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

TABLE = Path(__file__).parent / "evidence_speed.md"
PICTURE = TABLE.parents[1] / "assets" / "pictures" / "speed.png"
COLOURS = {"torch_radbp": "#0b62c4", "Mitsuba 3.9.1": "#d1a054"}


def soonest() -> dict[str, dict[str, float]]:
    """The fewest seconds to the common error, by task and renderer."""
    found, task = {}, ""
    table = TABLE.read_text(encoding="utf-8").partition("| task | renderer |")[2].partition("\n\n")[0]
    for line in table.splitlines()[2:]:
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        task, renderer, seconds = cells[0] or task, cells[1], cells[7]
        name = "torch_radbp" if renderer.startswith("ours") else "Mitsuba 3.9.1"
        if seconds != "not reached":
            of_task = found.setdefault(task, {})
            of_task[name] = min(float(seconds), of_task.get(name, float("inf")))
    return found


def draw(found: dict[str, dict[str, float]]) -> None:
    """Two bars for each task."""
    figure, axes = plt.subplots(figsize=(7.4, 3.6))
    for place, (name, colour) in enumerate(COLOURS.items()):
        seconds = [of_task[name] for of_task in found.values()]
        bars = axes.barh([row + 0.38 * place for row in range(len(found))], seconds, 0.36, color=colour, label=name)
        axes.bar_label(bars, [f"{value:.1f} s" for value in seconds], padding=3)
    axes.set_yticks([row + 0.19 for row in range(len(found))], list(found))
    axes.invert_yaxis()
    axes.set_xlabel("seconds until the same error is reached")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="upper right", bbox_to_anchor=(1, 1.06))
    axes.set_xlim(0, 28)
    figure.savefig(PICTURE, dpi=110, bbox_inches="tight", pil_kwargs={"optimize": True})


if __name__ == "__main__":
    draw(soonest())
