"""The images that a recipe's renderings are compared with."""

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.formats.image import read_image
from torch_radbp.interface.texture import LUMINANCE
from torch_radbp.photographs.picture import read_mask
from torch_radbp.plugin import nearest
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.training import recipe

MOST_NEGATIVE = 0.01  # share of the pixels; filters with negative lobes leave some beside bright ones


class Targets(NamedTuple):
    """Target images and the sensors that see them.

    Attributes:
        names: sensor names, one per image.
        sensors: their indices for `renderer(sensors=...)`.
        images: (B, 3, H, W), linear RGB.
        masks: (B, 1, H, W) in [0, 1], how much of each pixel counts; None: all count the same.
    """

    names: list[str]
    sensors: list[int]
    images: Tensor
    masks: Tensor | None = None

    def to(self, device: torch.device) -> "Targets":
        """The same with images and masks on a device."""
        return self._replace(images=self.images.to(device), masks=None if self.masks is None else self.masks.to(device))


def sensor_films(scene: Scene) -> dict[str, tuple[int, int]]:
    """Returns (height, width) of every sensor's image by name, in the order `renderer(sensors=)` counts."""
    return {name: (sensor.film.crop_height, sensor.film.crop_width) for name, sensor in scene.named_sensors.items()}


def read_targets(specs: list[recipe.Target], films: dict[str, tuple[int, int]]) -> Targets:
    """Reads the target images and checks each against the film of its sensor.

    Args:
        specs: the recipe's `[[targets]]`.
        films: (height, width) of the film of every sensor of the scene, by sensor name, in the scene's order.

    Raises:
        ValueError: unknown or repeated sensor, wrong size, NaN or infinity where the mask is not 0, negative radiance; a
            mask of another size, with values outside of [0, 1] or none above 0.
    """
    known = list(films)
    names = [_sensor_name(spec, known) for spec in specs]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"sensor {name!r} has {names.count(name)} targets; each sensor takes one")
    images, masks = zip(*(_read_target(spec, name, films[name]) for spec, name in zip(specs, names)))
    if len({image.shape for image in images}) > 1:
        sizes = ", ".join(f"{name} {image.shape[2]}x{image.shape[1]}" for name, image in zip(names, images))
        raise ValueError(f"the sensors of one run must have films of one size, got {sizes}")
    weights = torch.stack(masks) if any(spec.mask for spec in specs) else None
    return Targets(names, [known.index(name) for name in names], torch.stack(images), weights)


def _sensor_name(spec: recipe.Target, known: list[str]) -> str:
    if spec.sensor is None:
        if len(known) != 1:
            raise ValueError(f"target {spec.image}: the scene has {len(known)} sensors ({', '.join(known)}); name one")
        return known[0]
    if spec.sensor not in known:
        raise ValueError(f"target {spec.image}: no sensor {spec.sensor!r}; {nearest(spec.sensor, known)}")
    return spec.sensor


def _read_target(spec: recipe.Target, sensor: str, film: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """(3, H, W) image and (1, H, W) mask; NaN and infinity where the mask is 0 become 0."""
    image = read_image(spec.image)  # (H, W, 1 or 3)
    height, width = image.shape[:2]
    if (height, width) != tuple(film):
        raise ValueError(
            f"target {spec.image} is {width} x {height} pixels, but the film of sensor {sensor!r} is "
            f"{film[1]} x {film[0]}"
        )
    image = image.expand(-1, -1, 3)  # grey becomes colour
    mask = _read_mask(spec, image.permute(2, 0, 1))
    image = image.where(image.isfinite() | (mask[0, :, :, None] > 0), 0.0)
    bad = int((~image.isfinite()).sum())
    if bad:
        raise ValueError(f"target {spec.image} has {bad} values that are NaN or infinite; mend the image first, or give a "
                         f"mask that is 0 there")
    dark = int((image @ image.new_tensor(LUMINANCE) < 0).sum())
    if dark > MOST_NEGATIVE * height * width:
        raise ValueError(f"target {spec.image} has {dark} of {height * width} pixels of negative luminance, but radiance is "
                         f"at least 0; a target is a linear image, neither shifted nor normalised")
    return image.permute(2, 0, 1).contiguous(), mask


def _read_mask(spec: recipe.Target, image: Tensor) -> Tensor:
    """(1, H, W) weights of the pixels of a target; without a file 1."""
    if spec.mask is None:
        return torch.ones_like(image[:1])
    mask = read_mask(spec.mask)
    (height, width), size = mask.shape[1:], image.shape[1:]
    if (height, width) != size:
        raise ValueError(f"mask {spec.mask} is {width} x {height} pixels, but its target is {size[1]} x {size[0]}")
    if not ((mask >= 0) & (mask <= 1)).all():  # NaN, too
        raise ValueError(f"mask {spec.mask} must have values from 0, what does not count, to 1, got {mask.min().item():g} "
                         f"to {mask.max().item():g}")
    if not mask.any():
        raise ValueError(f"mask {spec.mask} is black: no pixel of its target counts; white is what counts")
    return mask.contiguous()
