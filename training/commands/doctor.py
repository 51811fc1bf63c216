"""`radbp doctor`: what is installed and what it runs on, and what to do about what is missing."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterator
from importlib import metadata
from typing import Annotated, NamedTuple

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from torch_radbp.install_hint import install_with
from torch_radbp.training.commands.clear_errors import Debug, clear_errors

EPILOG = (
    "Examples:\n\n"
    "radbp doctor  (what renders here, how fast, and what is missing; the exit code is 1 if something is wrong)\n\n"
    "radbp doctor --no-render  (without the small rendering at the end)\n\n"
    "Paste what it prints into a report of a fault."
)
NEEDED = ("torch", "numpy", "llvmlite", "embreex", "scipy", "OpenEXR", "Pillow", "kornia", "safetensors", "pydantic",
          "trimesh")
OPTIONAL = {  # by what they are for
    "warp-lang": f"rays on NVIDIA's GPUs: {install_with('cuda')}",
    "cuda-bindings": f"compiled rendering on NVIDIA's GPUs: {install_with('cuda')}",
    "lxml": "meshes in 3MF files: pip install lxml networkx",
    "pycollada": "meshes in COLLADA files: pip install pycollada",
    "xatlas": f"surface coordinates of baked meshes: {install_with('bake')}",
    "mitsuba": f"comparisons of the tests with Mitsuba: {install_with('peer')}",
}
SIZE = 64


class Finding(NamedTuple):
    """Something that was looked at."""

    what: str
    found: str
    wrong: str = ""  # what to do, if it must be mended
    advice: str = ""  # what to do, if it is wanted


def doctor(
    render: Annotated[bool, typer.Option(help="Render a small box, forward and backward, and compare it")] = True,
    debug: Debug = False,
) -> None:
    """Show what is installed and what it runs on, and what to do about what is missing."""
    with clear_errors(debug):
        table, wrong = Table(box=None, padding=(0, 2, 0, 0), show_header=False), 0
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for finding in findings(render):
            mark = "[red]wrong[/]: " if finding.wrong else ""
            words = "; ".join(part for part in (finding.found, finding.wrong or finding.advice) if part)
            table.add_row(finding.what, f"{mark}{escape(words)}")
            wrong += bool(finding.wrong)
        Console().print(table)
        if wrong:
            raise typer.Exit(1)


def findings(render: bool) -> Iterator[Finding]:
    """All that is looked at, in order."""
    yield Finding("torch_radbp", version("torch_radbp") or "run from its source")
    yield Finding("Python", f"{platform.python_version()} on {platform.platform()}")
    for name in NEEDED:
        found = version(name)
        yield Finding(name, found or "not installed", "" if found else f"pip install {name}")
    for name, use in OPTIONAL.items():
        found = version(name)
        yield Finding(name, found or "not installed", advice="" if found else f"for {use}")
    yield from processor()
    yield from gpu()
    if render:
        yield rendered()


def version(name: str) -> str | None:
    """Of a package; None: it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def processor() -> Iterator[Finding]:
    """What the processor is compiled for, threads, memory, and where compiled code is kept."""
    import torch

    from torch_radbp.jit.cpu.machine import host, host_width
    from torch_radbp.jit.store import code_cache
    from torch_radbp.rendering.cost import memory_of
    from torch_radbp.rendering.memory import bytes_text

    name = " ".join(host().split()[:2])  # without all that it can do
    yield Finding("processor", f"{name}, {host_width()} lanes of float32 at once, {os.cpu_count()} cores")
    threads = torch.get_num_threads()
    few = threads < (os.cpu_count() or 1)
    advice = "fewer than cores: set OMP_NUM_THREADS, or call torch.set_num_threads"
    yield Finding("threads", str(threads), advice=advice if few else "")
    yield Finding("memory", bytes_text(int(memory_of(torch.device("cpu")))))
    folder = code_cache.folder()
    if folder is None:
        yield Finding("compiled code", "is not kept: RADBP_KERNEL_CACHE is off",
                      advice="every process compiles for seconds; unset it to keep code")
    elif not code_cache.belongs_to_user(folder):
        yield Finding("compiled code", f"cannot be kept in {folder}",
                      "the folder must belong to you, and nobody else may write there: name another by RADBP_KERNEL_CACHE")
    else:
        yield Finding("compiled code", f"is kept in {folder}")


def gpu() -> Iterator[Finding]:
    """The GPUs that torch sees, and whether kernels can be launched there."""
    import torch

    if not torch.cuda.is_available():
        built = f"built for CUDA {torch.version.cuda}" if torch.version.cuda else "built for the CPU alone"
        yield Finding("GPU", f"none is seen by this torch, {built}")
        return
    from torch_radbp.jit.nvidia.driver import NoDriver, driver_of

    for number in range(torch.cuda.device_count()):
        device = torch.device("cuda", number)
        name = f"{torch.cuda.get_device_name(device)}, CUDA {torch.version.cuda}"
        try:
            driver_of(device)
        except NoDriver as error:
            yield Finding(f"GPU {number}", name, str(error))
        else:
            missing = version("warp-lang") is None
            yield Finding(f"GPU {number}", name, f"rays need {OPTIONAL['warp-lang']}" if missing else "")


def rendered() -> Finding:
    """A small rendering, compiled and not, forward and backward."""
    import torch

    import torch_radbp as rb
    from torch_radbp.training.commands.bundled import bundled_recipes
    from torch_radbp.training.recipe_file import read_recipe

    path = read_recipe(bundled_recipes()["cornell_reflectance"]).scene
    found, seconds = [], []
    for compile in (True, False):
        scene = rb.load(path, resolution=SIZE)
        colour = scene.get_parameter("red.reflectance.value").requires_grad_()
        renderer = rb.Renderer(scene, spp=4, max_depth=4, compile=compile)
        renderer(seed=1).mean().backward()
        colour.grad, start = None, time.perf_counter()
        image = renderer(seed=1)
        image.mean().backward()
        seconds.append(time.perf_counter() - start)
        found.append((image.detach(), colour.grad.clone()))
    (image, gradient), (expected, wanted) = found
    off = float((image - expected).norm() / expected.norm()), float((gradient - wanted).norm() / wanted.norm())
    words = (f"a box of {SIZE} x {SIZE} pixels, 4 samples, forward and backward: {1e3 * seconds[0]:.0f} ms compiled, "
             f"{1e3 * seconds[1]:.0f} ms in plain torch; they differ by {max(off):.0e}")
    right = max(off) < 1e-2 and bool(torch.isfinite(gradient).all()) and bool(gradient.any())
    return Finding("rendering", words, "" if right else "the two should agree: please report it, with all of this")
