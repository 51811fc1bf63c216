"""The curves of a report: the loss with its noise, the distance from the truth, and every small parameter."""

import html
from typing import Any

from torch_radbp.training.recovery.rigid import COMPONENTS
from torch_radbp.training.report.chart import Line, line_chart
from torch_radbp.training.report.curve_colours import CHANNELS, PALETTE, curve_colours

Rows = list[dict[str, float]]

WHY_BELOW_ZERO = (
    "The two-buffer loss is the product of the errors of two renderings, each with its own samples, averaged over pixels. "
    "Where the image is right only their noise is left, and the product of two independent noises is as often negative as "
    "positive: a curve that crosses zero has reached its noise, and its mean is what counts."
)


def curves_section(summary: dict[str, Any], rows: Rows) -> str:
    """Returns the section of curves, empty before the first step."""
    if not rows:
        return ""
    steps = [row["step"] for row in rows]
    charts = [_loss_chart(summary, steps, rows), _distance_chart(summary, steps, rows)]
    for each in summary["parameters"]:
        charts += _parameter_charts(each, steps, rows)
    note = f"<p class=note>{html.escape(WHY_BELOW_ZERO)}</p>" if "loss.two_buffer_l2" in rows[0] else ""
    return f'<section><h2>Curves</h2><div class="charts">{"".join(charts)}</div>{note}</section>'


def _loss_chart(summary: dict[str, Any], steps: list[float], rows: Rows) -> str:
    terms = [key for key in rows[0] if key.startswith("loss.")]
    values = [row["loss"] for row in rows]
    lines = [Line("loss", "#c3c9d6", steps, values), Line("running mean", PALETTE[0], steps, running_mean(values))]
    if len(terms) > 1:
        lines += [
            Line(f"{key.removeprefix('loss.')}, running mean", colour, steps, running_mean([row[key] for row in rows]))
            for key, colour in zip(terms, PALETTE[1:])
        ]
    # An unbiased two-buffer loss is negative now and then; a logarithm would hide those steps.
    log = all(value > 0 for line in lines for value in line.y)
    noise = summary["verdict"]["noise"]
    if noise:
        lines.append(Line("noise of one step", "#d0883c", [steps[0], steps[-1]], [noise, noise]))
    return line_chart("loss (logarithmic)" if log else "loss", lines, log)


def _distance_chart(summary: dict[str, Any], steps: list[float], rows: Rows) -> str:
    colours = curve_colours(summary["parameters"])
    lines = []
    for each in summary["parameters"]:
        kind, name = "chamfer" if "chamfer" in each else "rmse", each["name"]
        if f"{name}:{kind}" in rows[0]:
            distances = [row[f"{name}:{kind}"] for row in rows]
            lines.append(Line(name, colours[name], *_with_start(steps, each[f"{kind}_before"], distances)))
    return line_chart("distance from the truth, RMSE or Chamfer (logarithmic)", lines, log=True)


def _with_start(steps: list[float], before: float, values: list[float]) -> tuple[list[float], list[float]]:
    """The number of steps taken, and a parameter then, from its value before the first step on if that row is there."""
    taken = [step + 1 for step in steps]
    return ([0, *taken], [before, *values]) if steps[0] == 0 else (taken, values)


def running_mean(values: list[float]) -> list[float]:
    """Returns the mean over a window that ends at each value and is a tenth of them long."""
    window = max(1, len(values) // 10)
    return [sum(values[max(0, end - window) : end]) / min(end, window) for end in range(1, len(values) + 1)]


def _parameter_charts(parameter: dict[str, Any], steps: list[float], rows: Rows) -> list[str]:
    name, truth = parameter["name"], parameter.get("truth", [])
    if f"{name}:{COMPONENTS[0]}" in rows[0]:
        return _pose_charts(parameter, steps, rows)
    columns = [key for key in rows[0] if key == name or key.startswith(f"{name}[")]
    if columns:
        is_colour = len(columns) == 3
        colours = CHANNELS if is_colour else PALETTE
        labels = [f"{channel} channel" for channel in ("red", "green", "blue")] if is_colour else [
            key.removeprefix(name) or name for key in columns]
        lines = [
            Line(labels[index], colours[index % len(colours)],
                 *_with_start(steps, parameter["before"][index], [row[key] for row in rows]),
                 truth[index] if truth else None)
            for index, key in enumerate(columns)
        ]  # fmt: skip
        return [line_chart(name, lines)]
    if f"{name}:rmse" in rows[0] or f"{name}:chamfer" in rows[0]:
        return []
    line = _with_start(steps, parameter["mean_before"], [row[f"{name}:mean"] for row in rows])
    return [line_chart(f"{name}, mean", [Line("mean", PALETTE[0], *line)])]


def _pose_charts(parameter: dict[str, Any], steps: list[float], rows: Rows) -> list[str]:
    """Returns charts of the rotation vector and the translation from the initial pose."""
    name, goals = parameter["name"], parameter.get("true_motion", {})
    charts = []
    for keys, unit in ((COMPONENTS[:3], ", degrees"), (COMPONENTS[3:], "")):
        lines = [
            Line(key[-2], colour, *_with_start(steps, 0.0, [row[f"{name}:{key}"] for row in rows]), goals.get(key))
            for key, colour in zip(keys, CHANNELS)
        ]
        charts.append(line_chart(f"{name}, {keys[0][:-3]} from the start{unit}", lines))
    return charts
