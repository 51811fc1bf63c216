"""`radbp render`: a scene file in, an image file out."""

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from torch_radbp.training.commands.clear_errors import Debug, clear_errors
from torch_radbp.training.commands.device import Device
from torch_radbp.training.commands.outside import AllowOutside
from torch_radbp.training.commands.scene_variables import Define, parse_variables
from torch_radbp.training.progress import TimedProgress

# Passes of a long rendering, so that the progress bar moves; few enough that packing the scene costs nothing.
MOST_PASSES = 16

EPILOG = (
    "Examples:\n\n"
    "radbp render scene.xml -o image.exr  (linear, float32)\n\n"
    "radbp render scene.xml -o image.png --spp 256 --max-depth 8  (sRGB, values above 1 are cut off)\n\n"
    "radbp render scene.xml -o small.png -D resolution=64  (sets $resolution of the scene file)\n\n"
    "radbp render scene.xml -o image.exr --aov depth --aov sh_normal  (channels depth.T, sh_normal.X, ... beside R, G, B; "
    "with -o image.png pictures of their own: image_depth.png, ...)\n\n"
    "radbp render asset.glb -o asset.png -D resolution=512 -D light=0.5  (glTF: options of rb.load)\n\n"
    "With several sensors and no --sensor, each image gets the sensor's name: image_left.png, image_right.png"
)


def render(
    scene: Annotated[Path, typer.Argument(help="Scene: Mitsuba 3 .xml, or glTF .glb or .gltf")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Image to write, .exr or .png")],
    spp: Annotated[int | None, typer.Option(help=r"Samples per pixel.  \[default: the scene's]")] = None,
    max_depth: Annotated[
        int | None, typer.Option(help=r"1 = emission, 2 = direct light, -1 = unlimited.  \[default: the scene's]")
    ] = None,
    rr_depth: Annotated[int | None, typer.Option(help=r"Where roulette begins.  \[default: the scene's]")] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same image.", min=0)] = 0,
    sensor: Annotated[list[str] | None, typer.Option(help=r"Name of a sensor; may be repeated.  \[default: all]")] = None,
    aov: Annotated[
        list[str] | None,
        typer.Option(help=r"Output beside the image: depth, albedo, ...; may be repeated.  \[default: the integrator's]"),
    ] = None,
    chunk: Annotated[int | None, typer.Option(help="Paths traced at a time; less needs less memory.")] = None,
    compile: Annotated[
        bool, typer.Option("--compile/--eager", help="Fused loops, or plain torch: slower, but nothing to compile.")
    ] = True,
    light_paths: Annotated[
        str | None,
        typer.Option(help=r"Light by paths from lamps: camera (none), caustics, all, auto.  \[default: the scene's]"),
    ] = None,
    device: Device = None,
    define: Define = None,
    allow_outside: AllowOutside = False,
    debug: Debug = False,
) -> None:
    """Render a scene to an EXR (linear) or PNG (sRGB) image."""
    with clear_errors(debug):
        import torch_radbp as rb
        from torch_radbp.formats.image import WRITABLE
        from torch_radbp.rendering.settings import samples_per_pixel
        from torch_radbp.training.commands.outputs import image_paths, outputs_of, save_with_outputs
        from torch_radbp.training.device import usable_device
        from torch_radbp.training.recovery.passes import render_in_passes
        from torch_radbp.training.recovery.targets import sensor_films

        if output.suffix.lower() not in WRITABLE:
            raise ValueError(f"{output}: the image must end in {' or '.join(WRITABLE)}, got {output.suffix!r}")
        if not output.parent.is_dir():
            raise ValueError(f"{output}: no such folder: {output.parent}")
        loaded = rb.load(scene, allow_outside=allow_outside, **parse_variables(define)).to(usable_device(device))
        indices = chosen_sensors(sensor, list(sensor_films(loaded)))
        renderer = rb.Renderer(
            loaded, spp=spp, max_depth=max_depth, rr_depth=rr_depth, chunk=chunk, compile=compile, light_paths=light_paths
        )
        outputs = outputs_of(loaded, aov)
        paths = image_paths(output, list(indices), outputs)
        samples = {name: samples_per_pixel(spp, [loaded.sensors[index]]) for name, index in indices.items()}
        console = Console(stderr=True)
        started, done = time.perf_counter(), 0
        with TimedProgress(console, "samples per pixel", sum(samples.values())) as progress:
            for name, index in indices.items():

                def go_on(estimate, before=done) -> bool:
                    progress.update(before + estimate.spp)
                    return True

                passes = min(MOST_PASSES, max(1, samples[name] // 16))
                image = render_in_passes(renderer, [index], samples[name], seed, passes, go_on).image[0]
                save_with_outputs(paths[name], image, renderer, outputs, seed, index, samples[name])
                done += samples[name]
        width, height = image.shape[2], image.shape[1]
        for name, path in paths.items():
            console.print(f"{path}  {width} x {height}, {samples[name]} spp, {time.perf_counter() - started:.1f} s")


def chosen_sensors(wanted: list[str] | None, known: list[str]) -> dict[str, int]:
    """Returns the wanted sensors' indices by name, all of them if none is named."""
    from torch_radbp.plugin import nearest

    for name in wanted or []:
        if name not in known:
            raise ValueError(f"no sensor {name!r}; {nearest(name, known)}")
    return {name: known.index(name) for name in wanted or known}
