"""Writes a page for each category of plugins from their registry: pictures, examples, and parameters with defaults."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

from docs.contents import PAGES
from docs.plugin_code import python, runnable, xml
from docs.plugin_examples import EXAMPLES
from docs.plugin_pictures import draw
from docs.plugin_scenes import PLACE, python_scene, xml_render, xml_scene
from docs.plugin_table import prose, table
from torch_radbp.plugin import REGISTRY

DRAWN_BY = [Path(__file__).with_name(f"plugin_{name}.py") for name in ("examples", "pictures", "scenes")]


def write_plugin_pages(folder: Path) -> None:
    """Writes a page for each category, their index, and the pictures that are missing or out of date, into a folder."""
    folder.mkdir(exist_ok=True)
    for category in REGISTRY:
        (folder / f"{category}.md").write_text("\n".join(page(category)) + "\n")
        for name, example in EXAMPLES[category].items():
            picture = folder / f"{category}_{name}.png"
            if not example.like and out_of_date(picture):
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    draw(category, name, picture)
    (folder / "index.md").write_text("\n".join(index()) + "\n")


def out_of_date(picture: Path) -> bool:
    """True if a picture is missing, or older than what draws it."""
    return not picture.exists() or picture.stat().st_mtime < max(source.stat().st_mtime for source in DRAWN_BY)


def index() -> Iterator[str]:
    """The lines of the index."""
    yield from ("# Plugins", "", "What a scene is made of, by Mitsuba's names, with examples, parameters and defaults. "
                "`radbp info scene.xml` says how a scene's own parameters are called.", "", ":::{toctree}", ":hidden:",
                "", *REGISTRY, ":::", "", "| | |", "|---|---|")
    for category in REGISTRY:
        names = ", ".join(f"[`{name}`]({category}.md#{name})" for name in sorted(REGISTRY[category]))
        yield f"| [{PAGES[category].title}]({category}.md) | {names} |"


def page(category: str) -> Iterator[str]:
    """The lines of a category's page."""
    yield from (f"# {PAGES[category].title}", "", f"{PAGES[category].about} An example is a part of "
                "[this scene](#the-scene-around-the-examples). ∂ marks what has derivatives.")
    for name in sorted(REGISTRY[category]):
        yield from ("", f"## {name}", "", *entry(category, name))
    yield from ("", "## The scene around the examples", "", "In Python: an example, and after it these lines.", "",
                *fenced("python", python_scene(category)), "",
                f"In XML: `scene.xml`, in which an example stands in the place of `{PLACE}`,", "",
                *fenced("xml", xml_scene(category)), "", "and what renders it; `assets` is the folder of the files that "
                "come with the package.", "", *fenced("python", xml_render(category)))


def entry(category: str, name: str) -> Iterator[str]:
    """The lines of a plugin: what it is, a picture, an example twice, its keys, and what else there is to know."""
    plugin, example = REGISTRY[category][name], EXAMPLES[category][name]
    first, *others = prose(plugin)
    yield from (first, "", f"![{example.caption}]({category}_{example.like or name}.png)", "", f"*{example.caption}*", "",
                *fenced("python", runnable(f"example = {python(example.objects, 'example = ')}")), "",
                *fenced("xml", xml(example.objects)), "", *table(plugin))
    for paragraph in others:
        yield from ("", paragraph)


def fenced(language: str, text: str) -> Iterator[str]:
    """The lines of a block of code."""
    yield from (f"```{language}", *text.splitlines(), "```")
