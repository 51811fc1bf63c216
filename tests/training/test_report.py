"""report.html and the other files of a run."""

import base64
import io
import re
from html.parser import HTMLParser

import pytest
import safetensors.torch
import torch
from rich.console import Console

from docs.widths import CHROMIUM, too_wide
from tests.training.conftest import write_files
from torch_radbp.formats.image import read_image
from torch_radbp.training.false_colour import error_scale, false_colour
from torch_radbp.training.progress import TimedProgress, duration
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.passes import render_in_passes
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.report.chart import Line, line_chart
from torch_radbp.training.report.curve_colours import curve_colours
from torch_radbp.training.report.curves import curves_section, running_mean
from torch_radbp.training.run import run


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A run that is only looked at."""
    folder = write_files(tmp_path_factory.mktemp("files"))
    overrides = ["title='Paint & <picture>'", "parameters.0.name='p*.reflectance.[vd]*'", "parameters.0.truth=0.25",
                 "report.deviations='auto'"]
    run(folder / "recipe.toml", overrides, folder / "run", False, Console(quiet=True))
    return folder / "run"


class Page(HTMLParser):
    """Collects references, pictures and text, and checks that elements are closed in order."""

    VOID = {"meta", "img", "br", "link", "input"}

    def __init__(self, text):
        super().__init__()
        self.references, self.pictures, self.tags, self.text, self.open = [], [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        for name, value in attributes:
            if name in ("src", "href", "xlink:href", "srcset", "data"):
                (self.pictures if value.startswith("data:image/png;base64,") else self.references).append(value)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_report_is_self_contained(run_folder):
    text = (run_folder / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.references == []
    assert not re.search(r"https?:|//[a-z]|@import|url\(|<script|<link", re.sub(r"base64,[^\"]*", "", text))
    # before, after, target, error; before, recovered, true of the picture.
    assert len(page.pictures) == 7
    for picture in page.pictures:
        assert base64.b64decode(picture.split(",")[1]).startswith(b"\x89PNG")


def test_report_says_what_was_recovered(run_folder):
    page = Page((run_folder / "report.html").read_text(encoding="utf-8"))
    text = " ".join(page.text)
    assert "Paint & <picture>" in text, "the title is escaped"
    assert "paint.reflectance.value" in text and "0.2500" in text
    assert "4 × 4 × 3" in text
    assert "peak memory" in text and "MiB" in text
    assert "two_buffer_l2" in text, "the recipe is part of the report"
    assert page.tags.count("svg") == 4  # correlations, loss, distance from the truth, the colour's channels
    assert page.tags.count("polyline") >= 2 + 2 + 6


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: the width of the report is not looked at")
def test_the_report_fits_wide_and_narrow_screens(run_folder):
    assert too_wide(run_folder, ["report.html"]) == []


def test_every_error_says_what_it_is(run_folder):
    text = (run_folder / "report.html").read_text(encoding="utf-8")
    assert "images: mean of |after − target|" in text and "The root mean square of after − target is" in text
    for head in ("start", "recovered", "true", "largest error", "RMS error"):
        assert text.count(f'data-head="{head}"') == 2, "of each parameter, for screens on which columns do not fit"


def test_run_folder_is_complete(run_folder):
    expected = {"recipe.toml", "metrics.csv", "parameters.safetensors", "checkpoint.safetensors", "summary.json"}
    expected |= {"report.html", "images", "textures", "tensorboard", "scene"}
    assert {path.name for path in run_folder.iterdir()} == expected
    for role in ("before", "target", "after", "error"):
        assert read_image(run_folder / "images" / f"camera_{role}.exr").shape == (6, 8, 3)
        assert read_image(run_folder / "images" / f"camera_{role}.png").shape == (6, 8, 3)
    values = safetensors.torch.load_file(run_folder / "parameters.safetensors")
    assert {name: tuple(value.shape) for name, value in values.items()} == {
        "paint.reflectance.value": (3,),
        "picture.reflectance.data": (4, 4, 3),
    }
    assert not [path for path in run_folder.rglob("*") if path.name.startswith(".")], "no temporary file is left"
    assert next((run_folder / "tensorboard").iterdir()).stat().st_size > 0


def test_error_image_is_the_difference(run_folder):
    images = {role: read_image(run_folder / "images" / f"camera_{role}.exr") for role in ("after", "target", "error")}
    torch.testing.assert_close(images["error"], (images["after"] - images["target"]).abs(), atol=1e-6, rtol=0)


def test_chart_leaves_out_what_cannot_be_drawn():
    chart = line_chart("a < b", [Line("x", "red", [0, 1, 2, 3], [1.0, float("nan"), -1.0, 0.1])], log=True)
    points = re.search(r'<polyline points="([^"]*)" stroke="red" class="curve"', chart)[1].split()
    assert len(points) == 2
    assert "a &lt; b" in chart and "nan" not in chart
    assert line_chart("empty", [Line("x", "red", [0], [float("nan")])]) == ""


def test_chart_goes_up_where_values_do():
    chart = line_chart("rising", [Line("x", "red", [0, 1, 2], [1.0, 2.0, 5.0], goal=4.0)])
    curve = re.search(r'<polyline points="([^"]*)" stroke="red" class="curve"', chart)[1]
    heights = [float(point.split(",")[1]) for point in curve.split()]
    assert heights[0] > heights[1] > heights[2], "the y axis of SVG points down"
    goal = float(re.search(r'<polyline points="[^,]*,([0-9.]+)', chart)[1])
    assert heights[2] < goal < heights[1]


def test_long_curve_keeps_its_last_point():
    chart = line_chart("long", [Line("x", "red", list(range(5000)), [1.0] * 4999 + [9.0])])
    points = re.search(r'<polyline points="([^"]*)" stroke="red" class="curve"', chart)[1].split()
    assert len(points) < 500
    heights = [float(point.split(",")[1]) for point in points]
    assert heights[-1] < min(heights[:-1])


def test_false_colour_gets_lighter_with_the_error():
    levels = torch.linspace(0, 1.2, 25).expand(3, 1, 25)
    colours = false_colour(levels, scale=1.0)
    luminance = (colours * torch.tensor([0.2126, 0.7152, 0.0722])[:, None, None]).sum(0)[0]
    assert (luminance.diff()[:20] > 0).all()
    assert torch.equal(colours[..., -1], colours[..., -2]), "beyond the scale it stays at its brightest"


def test_one_firefly_does_not_set_the_error_scale():
    error = torch.full((3, 20, 20), 0.01)
    error[:, 3, 3] = 100.0
    assert error_scale(error) == pytest.approx(0.01)


def test_running_mean_of_a_short_and_a_long_series():
    assert running_mean([1.0, 2.0]) == [1.0, 2.0]
    assert running_mean([float(value) for value in range(40)])[-1] == pytest.approx(37.5)


@pytest.mark.parametrize(("seconds", "text"), [(4.26, "4.3 s"), (362, "6 min 02 s"), (7500, "2 h 05 min")])
def test_duration(seconds, text):
    assert duration(seconds) == text


def summary_of(**colours):
    return [{"name": name, "recovered": list(value), "truth": list(value)} for name, value in colours.items()]


def test_a_curve_has_the_colour_of_its_material():
    cornell = summary_of(white=(0.886, 0.699, 0.666), green=(0.105, 0.378, 0.076), red=(0.570, 0.043, 0.044))
    colours = curve_colours([*cornell, {"name": "alpha", "recovered": [0.2]}, {"name": "picture"}])
    levels = {name: [int(colour[at:at + 2], 16) for at in (1, 3, 5)] for name, colour in colours.items()}
    assert levels["green"][1] == max(levels["green"]) > 1.5 * levels["green"][0]
    assert levels["red"][0] == max(levels["red"]) > 1.5 * levels["red"][1]
    assert max(levels["white"]) - min(levels["white"]) < 40, "grey"
    assert len(set(colours.values())) == 5
    assert list(colours) == ["white", "green", "red", "alpha", "picture"]


def test_two_materials_of_one_colour_have_lines_that_can_be_told_apart():
    colours = curve_colours(summary_of(a=(0.5, 0.05, 0.05), b=(0.52, 0.05, 0.04), c=(0.6, 0.6, 0.6), d=(0.2, 0.2, 0.2)))
    assert len(set(colours.values())) == 4


def test_eight_numbers_have_lines_of_eight_colours():
    assert len(set(curve_colours([{"name": name, "recovered": [0.2]} for name in "abcdefgh"]).values())) == 8


def test_the_headline_says_what_the_run_is_and_which_parameter_is_furthest_off(folder, edit_recipe):
    recipe = edit_recipe("steps = 6", 'steps = 2\ndescription = "One <colour>."')
    run(recipe, [], folder / "run", False, Console(quiet=True))
    text = (folder / "run" / "report.html").read_text(encoding="utf-8")
    assert "One &lt;colour&gt;." in text and "largest parameter error, paint.reflectance.value" in text


def test_the_report_compares_with_a_slider_and_folds_the_recipe(run_folder):
    text = (run_folder / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.tags.count("input") == 1 and "clip-path" in text and "--at" in text
    assert "<details><summary>Recipe</summary>" in text and "<details open" not in text
    assert text.count("linear-gradient(to right,rgb(0,0,0)") == 1, "the colour bar of the error"
    assert "crosses zero" in text and "is noise of the rendering" in text


def test_the_sentence_on_zero_is_only_there_for_the_loss_that_crosses_it(folder, edit_recipe):
    run(edit_recipe('"two_buffer_l2"', '"l1"'), ["steps=2"], folder / "run", False, Console(quiet=True))
    assert "crosses zero" not in (folder / "run" / "report.html").read_text(encoding="utf-8")


def test_report_images_end_where_no_noise_is_seen(folder):
    spp = {}
    for name, value in {"few": 1e-9, "many": 1e9}.items():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("torch_radbp.training.recovery.outcome.INVISIBLE", value)
            overrides = ["steps=1", "report.spp=200"]
            summary, _ = run(folder / "recipe.toml", overrides, folder / name, False, Console(quiet=True))
        spp[name] = summary["image_spp"]
        assert summary["image_noise"] > 0
    assert spp == {"few": 200, "many": 58}  # 7 passes, and the first two of them


def test_the_noise_of_an_image_is_that_of_its_repetitions(folder):
    renderer = Recovery(read_recipe(folder / "recipe.toml")).renderer
    estimates = [render_in_passes(renderer, [0], 32, seed, 2, lambda _: True) for seed in range(0, 48, 2)]
    images = torch.stack([estimate.image for estimate in estimates])
    measured = images.std(0).square().mean().sqrt().item()
    said = sum(estimate.noise ** 2 for estimate in estimates) ** 0.5 / len(estimates) ** 0.5
    assert said == pytest.approx(measured, rel=0.15)


def test_progress_without_a_terminal_is_a_line_by_time():
    now, text = 0.0, io.StringIO()
    with TimedProgress(Console(file=text, width=200), "step", 100, done=10, clock=lambda: now) as progress:
        for step in range(11, 101):
            now += 2.0
            progress.update(step, note="loss 0.1")
    lines = text.getvalue().splitlines()
    assert lines[0] == "step 15/100  loss 0.1  10.0 s elapsed, 2 min 50 s left"
    assert 8 <= len(lines) <= 20
    assert lines[-1].endswith("s left") and "100/100" in lines[-1]


def test_progress_of_a_short_job_prints_nothing():
    text = io.StringIO()
    with TimedProgress(Console(file=text), "step", None) as progress:
        progress.update(5, 5)
    assert text.getvalue() == ""


@pytest.mark.parametrize(("first", "points"), [(0, 4), (5, 3)])
def test_the_curve_of_a_parameter_begins_at_its_value_before_the_first_step(first, points):
    parameter = {"name": "ior", "before": [1.0], "recovered": [4.0], "shape": [1], "picture": False}
    rows = [{"step": first + index, "loss": 1.0, "loss.l1": 1.0, "ior": 2.0 + index} for index in range(3)]
    section = curves_section({"parameters": [parameter], "verdict": {"noise": None}}, rows)
    curve = re.findall(r'<polyline points="([^"]*)" stroke="[^"]*" class="curve"', section)[-1].split()
    places = [tuple(map(float, point.split(","))) for point in curve]
    assert len(places) == points
    rises = [before[1] - after[1] for before, after in zip(places, places[1:])]
    assert max(rises) - min(rises) <= 0.2, "one unit a step, from the first on"
