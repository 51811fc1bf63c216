"""What `radbp render` writes beside an image: alpha, and quantities as channels of an EXR or as pictures."""

from collections import Counter
from pathlib import Path

import torch
from torch import Tensor

from torch_radbp.aov.quantity import channel_names, checked_names, plain
from torch_radbp.formats.file_names import file_name
from torch_radbp.formats.image import save_image, srgb_to_linear
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.scene.modules.scene import Scene

DIRECTIONS = ("geo_normal", "sh_normal")  # of unit length: -1 is black, 1 is white
COLOURS = ("albedo", "xyz")


def outputs_of(scene: Scene, wanted: list[str] | None) -> dict[str, str]:
    """Returns the quantities to write, by the names of their outputs: those named, or else those of the scene."""
    return {name: name for name in checked_names(wanted)} if wanted else scene.integrator.outputs()


def path_of(path: Path, name: str) -> Path:
    """Returns where the picture of an output, or of a sensor, is written: beside `path`, with the name in it."""
    return path.with_name(f"{path.stem}_{file_name(name)}{path.suffix}")


def image_paths(path: Path, sensors: list[str], outputs: dict[str, str]) -> dict[str, Path]:
    """Returns where the image of each sensor is written: at `path`, or beside it if there are several.

    Raises:
        ValueError: if the picture of an output would have the name of another picture.
    """
    images = {name: path if len(sensors) == 1 else path_of(path, name) for name in sensors}
    files = list(images.values())
    if path.suffix.lower() != ".exr":
        files += [path_of(image, name) for image in images.values() for name in outputs]
    file, count = Counter(files).most_common(1)[0]
    if count > 1:
        raise ValueError(f"{file}: {count} pictures would have this name; write an .exr, which holds all outputs of a "
                         "sensor, or choose sensors with --sensor")
    return images


def save_with_outputs(path: Path, image: Tensor, renderer: Renderer, outputs: dict[str, str], seed: int, sensor: int,
                      spp: int) -> None:
    """Writes an image with its alpha channel, if the film has one, and with its outputs.

    Args:
        path: .exr, for a file of all channels, or .png, for pictures beside it.
        image: (3, H, W) of the sensor.
        renderer: renders the outputs.
        outputs: quantities by name.
        seed, sensor, spp: of the rendering.
    """
    scene = renderer.scene
    alpha = scene.integrator.alpha() if scene.sensors[sensor].film.pixel_format == "rgba" else None
    quantities = dict.fromkeys([*outputs.values(), *([] if alpha is None else [alpha])])
    found = {}
    if quantities:
        with torch.no_grad():
            found = renderer.aovs(list(quantities), seed, [sensor], spp)
    if alpha is not None:
        image = torch.cat([image, found[alpha][0].to(image)])
    if path.suffix.lower() != ".exr":
        save_image(path, image)
        for name, quantity in outputs.items():
            save_image(path_of(path, name), picture(quantity, found[quantity][0]))
        return
    channels = {channel: values for name, quantity in outputs.items()
                for channel, values in zip(channel_names(name, quantity), found[quantity][0])}
    save_image(path, image, channels)


def picture(quantity: str, values: Tensor) -> Tensor:
    """Computes how a quantity is shown: linear RGB, (3, H, W), of values (C, H, W).

    Colours as they are, normals from -1 to 1, everything else from its least to its largest value; one number is grey, and
    of two the third channel is black.
    """
    if plain(quantity) in COLOURS:
        return values
    if quantity in DIRECTIONS:
        levels = 0.5 + 0.5 * values
    else:
        low, high = values.amin(), values.amax()
        levels = (values - low) / (high - low).clamp_min(torch.finfo(values.dtype).tiny)
    if len(levels) == 1:
        return srgb_to_linear(levels.expand(3, -1, -1))
    return srgb_to_linear(torch.cat([levels, levels.new_zeros(3 - len(levels), *levels.shape[1:])]))
