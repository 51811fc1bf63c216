"""report.html: one page that holds pictures, curves and tables of a run, and needs no network."""

import base64
import html
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch

from torch_radbp.io.atomic import replacing
from torch_radbp.io.image import linear_to_srgb
from torch_radbp.training.chart import Line, line_chart
from torch_radbp.training.progress import duration
from torch_radbp.training.recipe import Recipe
from torch_radbp.training.report_style import STYLE
from torch_radbp.training.rigid import COMPONENTS
from torch_radbp.training.run_folder import RunFolder

CHANNEL_COLOURS = ("#c8383a", "#2e8b4f", "#2f6fb5")
OTHER_COLOURS = ("#3b4a6b", "#b86b1d", "#7a4a9c", "#1f8a8a", "#a33d6b", "#5f6b1f")
PICTURE_ROLES = ("before", "after", "target", "error")
TEXTURE_ROLES = ("before", "recovered", "true")


def write_report(folder: RunFolder) -> Path:
    """Writes the report of a run folder from its summary, metrics, images and recipe; returns its path."""
    summary = folder.load_summary()
    recipe_text = (folder.path / Recipe.FILE_NAME).read_text(encoding="utf-8")
    rows = folder.metrics.rows()
    body = "".join(
        [
            _headline(summary),
            _pictures(folder, summary),
            _parameters_table(summary),
            _textures(folder, summary),
            _curves(summary, rows),
            _cost(summary),
            f"<section><h2>Recipe</h2><pre>{html.escape(recipe_text)}</pre></section>",
        ]
    )
    title = html.escape(summary["title"])
    page = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>'
        f"<body><main>{body}</main></body></html>\n"
    )
    with replacing(folder.report) as partial:
        partial.write_text(page, encoding="utf-8")
    return folder.report


def _headline(summary: dict[str, Any]) -> str:
    status, step, steps = summary["status"], summary["step"], summary["steps"]
    state = f"{step} steps" if status == "finished" else f"{status} at step {step} of {steps}"
    cells = [("state", state), ("time", duration(summary["cost"]["seconds"]))]
    for each in summary["parameters"]:
        if "pose_error" in each:
            cells.append((f"pose of {each['name']}", _pose_errors(each)))
    errors = [each["largest_error"] for each in summary["parameters"] if "truth" in each]
    if errors:
        cells.append(("largest parameter error", f"{max(errors):.4f}"))
    for each in summary["parameters"]:
        if "rmse" in each and "truth" not in each:
            cells.append((f"RMSE of {each['name']}", f"{each['rmse']:.4f} (was {each['rmse_before']:.4f})"))
    if summary["images"]:
        mean = sum(each["mean_error"] for each in summary["images"]) / len(summary["images"])
        cells.append(("mean image error", f"{mean:.4f}"))
    if summary["skipped"]:
        cells.append(("skipped steps", str(summary["skipped"])))
    facts = "".join(f"<div><dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd></div>" for k, v in cells)
    return f"<header><h1>{html.escape(summary['title'])}</h1><dl>{facts}</dl></header>"


def _pose_errors(parameter: dict[str, Any]) -> str:
    now, before = parameter["pose_error"], parameter["pose_error_before"]
    return (f"off by {now['angle']:.3f}° and {now['distance']:.5f} "
            f"(was {before['angle']:.2f}° and {before['distance']:.3f})")


def _pictures(folder: RunFolder, summary: dict[str, Any]) -> str:
    parts = []
    for each in summary["images"]:
        captions = {"error": f"|after − target|, brightest = {each['error_scale']:.3g}"}
        figures = (
            _figure(folder.image_path(each["sensor"], role), role, captions.get(role, "")) for role in PICTURE_ROLES
        )
        name = f"<h3>{html.escape(each['sensor'])}</h3>" if len(summary["images"]) > 1 else ""
        parts.append(f'{name}<div class="pictures">{"".join(figures)}</div>')
    return f"<section><h2>Images</h2>{''.join(parts)}</section>"


def _textures(folder: RunFolder, summary: dict[str, Any]) -> str:
    parts = []
    for each in summary["parameters"]:
        if each["picture"]:
            figures = "".join(_figure(folder.texture_path(each["name"], role), role, "") for role in TEXTURE_ROLES)
            parts.append(f'<h3>{html.escape(each["name"])}</h3><div class="pictures textures">{figures}</div>')
    return f"<section><h2>Textures</h2>{''.join(parts)}</section>" if parts else ""


def _figure(path: Path, role: str, note: str) -> str:
    if not path.exists():
        return ""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    caption = f"{role} <small>{html.escape(note)}</small>" if note else role
    return f'<figure><img alt="{role}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'


def _parameters_table(summary: dict[str, Any]) -> str:
    parameters = summary["parameters"]
    with_truth = any("largest_error" in each for each in parameters)
    heads = ["parameter", "start", "recovered"] + (["true", "largest error", "RMSE"] if with_truth else [])
    rows = []
    for each in parameters:
        small = "recovered" in each
        shape = "" if small else f"<small>{' × '.join(map(str, each['shape']))}</small>"
        cells = [f"<th>{html.escape(each['name'])}{shape}</th>"]
        cells.append(_value(each["before"]) if small else _mean(each["mean_before"]))
        cells.append(_value(each["recovered"]) if small else _mean(each["mean"]))
        if with_truth and "largest_error" in each:
            cells.append(_value(each["truth"]) if small else _mean(each["mean_truth"]))
            cells += [f"<td class=number>{each['largest_error']:.4f}</td>", f"<td class=number>{each['rmse']:.4f}</td>"]
        elif with_truth:
            cells.append("<td colspan=3>not known</td>")
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = "".join(f"<th>{name}</th>" for name in heads)
    return f"<section><h2>Parameters</h2><table><tr>{head}</tr>{''.join(rows)}</table></section>"


def _mean(value: float) -> str:
    return f"<td class=number>mean {value:.4f}</td>"


def _value(entries: list[float]) -> str:
    swatch = ""
    if len(entries) == 3:
        swatch = f'<i class="swatch" style="background:{css_colour(entries)}"></i>'
    if len(entries) == 16:
        rows = ("&ensp;".join(f"{entry:.4f}" for entry in entries[first : first + 4]) for first in range(0, 16, 4))
        return f"<td class=number>{'<br>'.join(rows)}</td>"
    return f"<td class=number>{swatch}{'&ensp;'.join(f'{entry:.4f}' for entry in entries)}</td>"


def css_colour(linear: Iterable[float]) -> str:
    """Returns linear RGB, cut to [0, 1], as a CSS colour."""
    encoded = linear_to_srgb(torch.tensor(list(linear)).clamp(0, 1))
    return f"rgb({','.join(str(round(255 * value)) for value in encoded.tolist())})"


def _curves(summary: dict[str, Any], rows: list[dict[str, float]]) -> str:
    if not rows:
        return ""
    steps = [row["step"] for row in rows]
    charts = [_loss_chart(steps, rows), _distance_chart(summary, steps, rows)]
    for each in summary["parameters"]:
        charts += _parameter_charts(each, steps, rows)
    return f'<section><h2>Curves</h2><div class="charts">{"".join(charts)}</div></section>'


def _loss_chart(steps: list[float], rows: list[dict[str, float]]) -> str:
    terms = [key for key in rows[0] if key.startswith("loss.")]
    values = [row["loss"] for row in rows]
    mean = Line("running mean", OTHER_COLOURS[0], steps, running_mean(values))
    lines = [Line("loss", "#c3c9d6", steps, values), mean]
    if len(terms) > 1:
        lines += [
            Line(f"{key.removeprefix('loss.')}, running mean", colour, steps, running_mean([row[key] for row in rows]))
            for key, colour in zip(terms, OTHER_COLOURS[1:])
        ]
    # An unbiased two-buffer loss is negative now and then; a logarithm would hide those steps.
    log = all(value > 0 for line in lines for value in line.y)
    return line_chart("loss (logarithmic)" if log else "loss", lines, log)


def _distance_chart(summary: dict[str, Any], steps: list[float], rows: list[dict[str, float]]) -> str:
    names = [each["name"] for each in summary["parameters"] if f"{each['name']}:rmse" in rows[0]]
    lines = [
        Line(name, OTHER_COLOURS[index % len(OTHER_COLOURS)], steps, [row[f"{name}:rmse"] for row in rows])
        for index, name in enumerate(names)
    ]
    return line_chart("distance from the truth, RMSE (logarithmic)", lines, log=True)


def running_mean(values: list[float]) -> list[float]:
    """Returns the mean over a window that ends at each value and is a tenth of them long."""
    window = max(1, len(values) // 10)
    return [sum(values[max(0, end - window) : end]) / min(end, window) for end in range(1, len(values) + 1)]


def _parameter_charts(parameter: dict[str, Any], steps: list[float], rows: list[dict[str, float]]) -> list[str]:
    name, truth = parameter["name"], parameter.get("truth", [])
    if f"{name}:{COMPONENTS[0]}" in rows[0]:
        return _pose_charts(parameter, steps, rows)
    columns = [key for key in rows[0] if key == name or key.startswith(f"{name}[")]
    charts = []
    if columns:
        colours = CHANNEL_COLOURS if len(columns) == 3 else OTHER_COLOURS
        labels = ("red", "green", "blue") if len(columns) == 3 else [key.removeprefix(name) or name for key in columns]
        lines = [
            Line(labels[index], colours[index % len(colours)], steps, [row[key] for row in rows],
                 truth[index] if truth else None)
            for index, key in enumerate(columns)
        ]  # fmt: skip
        charts.append(line_chart(name, lines))
    elif f"{name}:rmse" not in rows[0]:
        lines = [Line("mean", OTHER_COLOURS[0], steps, [row[f"{name}:mean"] for row in rows])]
        charts.append(line_chart(f"{name}, mean", lines))
    return charts


def _pose_charts(parameter: dict[str, Any], steps: list[float], rows: list[dict[str, float]]) -> list[str]:
    """Charts of the rotation vector and the translation from the initial pose."""
    name, goals = parameter["name"], parameter.get("true_motion", {})
    charts = []
    for keys, unit in ((COMPONENTS[:3], ", degrees"), (COMPONENTS[3:], "")):
        lines = [
            Line(key[-2], colour, steps, [row[f"{name}:{key}"] for row in rows], goals.get(key))
            for key, colour in zip(keys, CHANNEL_COLOURS)
        ]
        charts.append(line_chart(f"{name}, {keys[0][:-3]} from the start{unit}", lines))
    return charts


def _cost(summary: dict[str, Any]) -> str:
    cost, machine = summary["cost"], summary["machine"]
    rows = [("optimisation", duration(cost["seconds"]))]
    if "median_forward_seconds" in cost:
        rows.append(("forward pass, median", f"{cost['median_forward_seconds']:.3f} s"))
        rows.append(("backward pass, median", f"{cost['median_backward_seconds']:.3f} s"))
    rows.append(("peak memory", f"{cost['peak_memory_bytes'] / 2**20:.0f} MiB"))
    rows.append(("device", f"{machine['device']}, {machine['threads']} threads"))
    rows.append(("software", f"torch {machine['torch']}, Python {machine['python']}"))
    cells = "".join(f"<tr><th>{name}</th><td>{html.escape(value)}</td></tr>" for name, value in rows)
    return f"<section><h2>Time and memory</h2><table class=narrow>{cells}</table></section>"

