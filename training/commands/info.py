"""`radbp info`: what is in a scene, what its parameters are called, and which of them have derivatives."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from torch_radbp.training.commands.clear_errors import Debug, clear_errors
from torch_radbp.training.commands.outside import AllowOutside
from torch_radbp.training.commands.scene_variables import Define, parse_variables

EPILOG = (
    "Examples:\n\n"
    "radbp info scene.xml\n\n"
    "radbp info scene.xml -D resolution=64\n\n"
    "radbp info asset.glb  (and what of it is not read)\n\n"
    "The names under PARAMETERS are those of scene.get_parameter(name) and of the parameters in a recipe."
)


def info(
    scene: Annotated[Path, typer.Argument(help="Scene: Mitsuba 3 .xml, or glTF .glb or .gltf")],
    define: Define = None,
    allow_outside: AllowOutside = False,
    debug: Debug = False,
) -> None:
    """Show shapes, media, emitters, sensors and parameters of a scene, and what is not supported."""
    with clear_errors(debug):
        import torch_radbp as rb

        loaded = rb.load(scene, allow_outside=allow_outside, **parse_variables(define))
        console = Console()
        console.print(f"[bold]{scene}[/]", soft_wrap=True)
        for table in (_shapes(loaded), _media(loaded), _emitters(loaded), _sensors(loaded), _integrator(loaded),
                      _parameters(loaded)):
            if table.row_count:
                console.print(table)
        console.print(_supported(), style="dim")


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for heading in headings:
        table.add_column(heading, overflow="fold")
    return table


def _shapes(scene) -> Table:
    table = _table("SHAPES", "name", "type", "triangles", "bsdf", "emits")
    total = 0
    for shape, instances in zip(scene.shapes, scene.shown_by):
        triangles = len(shape.faces) * (1 if instances is None else len(instances))
        total += triangles
        bsdf = f"{scene.name_of(shape.bsdf)} ({shape.bsdf.type})"
        table.add_row(scene.name_of(shape), shape.type, f"{triangles:,}", bsdf, "" if shape.emitter is None else "yes")
    table.caption = f"{len(scene.shapes)} shapes, {total:,} triangles"
    return table


def _media(scene) -> Table:
    table = _table("MEDIA", "name", "type", "extinction", "grid", "emission", "where")
    for medium in scene.media:
        places = ["around all sensors"] if medium is scene.around else []
        for shape in scene.shapes:
            name = scene.name_of(shape)
            places += [f"in {name}"] * (shape.interior is medium) + [f"around {name}"] * (shape.exterior is medium)
        extinction = medium.scale * medium.sigma_t.samples()
        grid = " x ".join(map(str, extinction.shape)) if extinction.ndim == 4 else ""
        emission = "" if medium.emission is None else _range(medium.emission.samples())
        table.add_row(scene.name_of(medium), medium.type, _range(extinction), grid, emission, ", ".join(places))
    table.caption = "extinction and emission: the least and the largest; extinction with the scale; both 1 / length"
    return table


def _range(values) -> str:
    """The least and the largest of some values."""
    return " to ".join(dict.fromkeys(f"{float(end):.4g}" for end in (values.min(), values.max())))


def _emitters(scene) -> Table:
    table = _table("EMITTERS", "name", "type")
    for emitter in scene.emitters:
        table.add_row(scene.name_of(emitter), emitter.type)
    return table


def _sensors(scene) -> Table:
    table = _table("SENSORS", "name", "type", "image", "crop", "view", "filter", "spp")
    for sensor in scene.sensors:
        film = sensor.film
        is_whole = (film.crop_width, film.crop_height) == (film.width, film.height)
        crop = f"{film.crop_width} x {film.crop_height} at ({film.crop_offset_x}, {film.crop_offset_y})"
        table.add_row(
            scene.name_of(sensor), sensor.type, f"{film.width} x {film.height}", "" if is_whole else crop,
            sensor.view(), film.rfilter.type, str(sensor.sampler.sample_count),
        )  # fmt: skip
    return table


def _integrator(scene) -> Table:
    table = _table("RENDERER DEFAULTS", "setting", "value", "meaning")
    defaults = scene.integrator
    depth = "unlimited" if defaults.max_depth == -1 else str(defaults.max_depth)
    table.add_row("max_depth", depth, "1 = emission only, 2 = direct light")
    table.add_row("rr_depth", str(defaults.rr_depth), "scattering events before Russian roulette")
    table.add_row("hide_emitters", str(defaults.hide_emitters), "emitters seen directly are left out")
    table.add_row("light_paths", defaults.light_paths, "which light comes by paths that begin at lamps")
    return table


def _parameters(scene) -> Table:
    table = _table("PARAMETERS", "name", "shape", "mean", "derivative")
    differentiable = _Differentiable(scene)
    for name, parameter in scene.named_parameters():
        shape = " x ".join(map(str, parameter.shape)) or "number"
        table.add_row(name, shape, f"{parameter.mean().item():.4g}", "yes" if differentiable(name) else "not yet")
    table.caption = "names as in scene.get_parameter(name) and in recipes"
    return table


class _Differentiable:
    """Tells which parameters the image depends on; computed once for each kind, since it takes packing the scene."""

    def __init__(self, scene):
        self.scene = scene
        self.known: dict[tuple, bool] = {}

    def __call__(self, name: str) -> bool:
        from torch_radbp.scene.packing.pack import pack
        from torch_radbp.tensors.differentiated import any_differentiated

        owner, _, attribute = name.rpartition(".")
        holder, _, _ = owner.rpartition(".")
        kind = (type(self.scene.get_submodule(holder)), type(self.scene.get_submodule(owner)), attribute)
        if kind not in self.known:
            parameter = self.scene.get_parameter(name).requires_grad_()
            self.known[kind] = any_differentiated((pack(self.scene), [sensor.tensors() for sensor in self.scene.sensors]))
            parameter.requires_grad_(False)
        return self.known[kind]


def _supported() -> str:
    """Returns one line per category: everything else is refused by name when a scene is read."""
    from torch_radbp.plugin import REGISTRY

    lines = [f"  {category}: {', '.join(sorted(types))}" for category, types in REGISTRY.items() if types]
    return "Supported here; any other plugin or attribute is not, and is refused by name:\n" + "\n".join(lines)
