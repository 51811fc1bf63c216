"""`report.html`: one page that holds pictures, curves and tables of a run, and needs no network."""

import html
from pathlib import Path
from typing import Any

from torch_radbp.formats.atomic import replacing
from torch_radbp.training.progress import duration
from torch_radbp.training.recipe import Recipe
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.training.report.curve_colours import srgb_levels
from torch_radbp.training.report.curves import curves_section
from torch_radbp.training.report.deviations import deviations_section
from torch_radbp.training.report.pictures import pictures_section, textures_section
from torch_radbp.training.report.style import STYLE


def write_report(folder: RunFolder) -> Path:
    """Writes the report of a run folder from its summary, metrics, images and recipe; returns its path."""
    summary = folder.load_summary()
    recipe_text = (folder.path / Recipe.FILE_NAME).read_text(encoding="utf-8")
    rows = folder.metrics.rows()
    body = "".join(
        [
            _headline(summary),
            pictures_section(folder, summary),
            _parameters_table(summary),
            textures_section(folder, summary),
            deviations_section(folder, summary),
            curves_section(summary, rows),
            _cost(summary),
            f"<section><details><summary>Recipe</summary><pre>{html.escape(recipe_text)}</pre></details></section>",
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
    cells = [("state", state), ("verdict", summary["verdict"]["word"]), ("time", duration(summary["cost"]["seconds"]))]
    for each in summary["parameters"]:
        if "pose_error" in each:
            cells.append((f"pose of {each['name']}", _pose_errors(each)))
        if "chamfer" in each:
            distances = f"{each['chamfer']:.4f} (was {each['chamfer_before']:.4f})"
            cells.append((f"Chamfer distance of {each['name']}", distances))
    errors = [(each["largest_error"], each["name"]) for each in summary["parameters"] if "truth" in each]
    if errors:
        cells.append((f"largest parameter error, {max(errors)[1]}", f"{max(errors)[0]:.2g}"))
    for each in summary["parameters"]:
        if "rmse" in each and "truth" not in each:
            cells.append((f"RMSE of {each['name']}", f"{each['rmse']:.4f} (was {each['rmse_before']:.4f})"))
    if summary["images"]:
        mean = sum(each["mean_error"] for each in summary["images"]) / len(summary["images"])
        cells.append(("images: mean of |after − target|", f"{mean:.4f}"))
    if summary["skipped"]:
        cells.append(("skipped steps", str(summary["skipped"])))
    facts = "".join(f"<div><dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd></div>" for k, v in cells)
    verdict = f"<p class=note>{html.escape(summary['verdict']['explanation'])}</p>"
    about = f"<p class=about>{html.escape(summary['description'])}</p>" if summary["description"] else ""
    return f"<header><h1>{html.escape(summary['title'])}</h1>{about}<dl>{facts}</dl>{verdict}</header>"


def _pose_errors(parameter: dict[str, Any]) -> str:
    now, before = parameter["pose_error"], parameter["pose_error_before"]
    return (f"off by {now['angle']:.3f}° and {now['distance']:.5f} "
            f"(was {before['angle']:.2f}° and {before['distance']:.3f})")


def _parameters_table(summary: dict[str, Any]) -> str:
    parameters = summary["parameters"]
    with_truth = any("largest_error" in each for each in parameters)
    heads = ["parameter", "start", "recovered"] + (["true", "largest error", "RMS error"] if with_truth else [])
    rows = []
    for each in parameters:
        small = "recovered" in each
        shape = "" if small else f"<small>{' × '.join(map(str, each['shape']))}</small>"
        cells = [f"<th>{html.escape(each['name'])}{shape}</th>"]
        known = with_truth and "largest_error" in each
        if small:
            values = [_value(each[key]) for key in ("before", "recovered", *(["truth"] if known else []))]
        else:
            values = [_mean(each[key]) for key in ("mean_before", "mean", *(["mean_truth"] if known else []))]
        values += [f"{each[key]:.2g}" for key in ("largest_error", "rmse")] if known else ["not known"] * (3 * with_truth)
        cells += [f'<td class=number data-head="{name}">{value}</td>' for name, value in zip(heads[1:], values)]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = "".join(f"<th>{name}</th>" for name in heads)
    return f"<section><h2>Parameters</h2><table class=parameters><tr>{head}</tr>{''.join(rows)}</table></section>"


def _mean(value: float) -> str:
    return f"mean {value:.4f}"


def _value(entries: list[float]) -> str:
    swatch = ""
    if len(entries) == 3:
        colour = ",".join(map(str, srgb_levels(entries)))
        swatch = f'<i class="swatch" style="background:rgb({colour})"></i>'
    if len(entries) == 16:
        rows = ("&ensp;".join(f"{entry:.4f}" for entry in entries[first : first + 4]) for first in range(0, 16, 4))
        return f"<span>{'<br>'.join(rows)}</span>"
    return f"<span>{swatch}{'&ensp;'.join(f'{entry:.4f}' for entry in entries)}</span>"


def _cost(summary: dict[str, Any]) -> str:
    cost, machine = summary["cost"], summary["machine"]
    rows = [("optimisation", duration(cost["seconds"]))]
    if "median_forward_seconds" in cost:
        rows.append(("forward pass, median", f"{cost['median_forward_seconds']:.3f} s"))
        rows.append(("backward pass, median", f"{cost['median_backward_seconds']:.3f} s"))
    peak = cost["peak_memory_bytes"]
    rows.append(("peak memory", "not known" if peak is None else f"{peak / 2**20:.0f} MiB"))
    rows.append(("device", f"{machine['device']}, {machine['threads']} threads"))
    rows.append(("software", f"torch {machine['torch']}, Python {machine['python']}"))
    cells = "".join(f"<tr><th>{name}</th><td>{html.escape(value)}</td></tr>" for name, value in rows)
    return f"<section><h2>Time and memory</h2><table class=narrow>{cells}</table></section>"

