"""The cameras of photographs: their names in a scene, and their sizes, which are those of the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torch_radbp.formats.image import READABLE
from torch_radbp.formats.pillow import turned_by
from torch_radbp.photographs.picture import Picture, Source, picture_name, picture_size
from torch_radbp.plugin import positive
from torch_radbp.sensor.kind import ProjectiveCamera

ROUNDING = 1  # pixel by which the size of a scaled file may differ from the scaled size


def named_as_in_a_scene(cameras: Mapping[str, Any]) -> dict[str, ProjectiveCamera]:
    """Cameras under the names that a scene allows: dots become underscores.

    Raises:
        TypeError: if one is no camera of one image.
        ValueError: if two have one name.
    """
    named: dict[str, ProjectiveCamera] = {}
    for name, camera in cameras.items():
        if not isinstance(camera, ProjectiveCamera):
            raise TypeError(f"the camera {name!r} must be a sensor of one image, such as rb.camera_from_opencv gives, got "
                            f"{type(camera).__name__}")
        name = name.replace(".", "_")
        if name in named:
            raise ValueError(f"two cameras are called {name!r} in a scene, where dots become underscores; rename one")
        named[name] = camera
    return named


def scaled_to_files(cameras: Mapping[str, ProjectiveCamera], pictures: Sequence[Picture],
                    scale: float) -> dict[str, ProjectiveCamera]:
    """Rescales cameras to downsampled image files, whose sizes may have been rounded either way.

    Raises:
        ValueError: if a file does not have about the scaled size.
    """
    if positive("scale", scale) == 1:
        return dict(cameras)
    scaled = {}
    for (name, camera), picture in zip(cameras.items(), pictures):
        size, whole = picture_size(picture.image), (camera.film.width, camera.film.height)
        if any(abs(side - scale * full) > ROUNDING for side, full in zip(size, whole)):
            turned = turned_advice(picture.image, size, tuple(scale * full for full in whole))
            raise ValueError(f"{picture_name(picture.image)} has {size[0]} x {size[1]} pixels, and its camera {whole[0]} x "
                             f"{whole[1]}, which is {whole[0] * scale:g} x {whole[1] * scale:g} with scale={scale:g}"
                             f"{f'; {turned}' if turned else ''}")
        scaled[name] = camera.resized(*size)
    return scaled


def checked_size(name: str, camera: ProjectiveCamera, picture: Picture) -> tuple[int, int]:
    """Checks that a photograph, its mask and its camera's film have one size, and returns it: width and height.

    Raises:
        ValueError: if they are not.
    """
    width, height = picture_size(picture.image)
    film = camera.film
    if (width, height) != (film.crop_width, film.crop_height):
        scale = width / film.crop_width
        reduced = scale < 1 and abs(height - scale * film.crop_height) <= ROUNDING
        turned = turned_advice(picture.image, (width, height), (film.crop_width, film.crop_height))
        advice = turned or (f"if the files were reduced, say scale={scale:.4g}" if reduced
                            else "is it the image of that camera?")
        raise ValueError(f"{picture_name(picture.image)} has {width} x {height} pixels, and its camera {name!r} "
                         f"{film.crop_width} x {film.crop_height}; {advice}")
    if picture.mask is not None and picture_size(picture.mask) != (width, height):
        mask_size = picture_size(picture.mask)
        raise ValueError(f"the mask {picture_name(picture.mask)} has {mask_size[0]} x {mask_size[1]} pixels, and its image "
                         f"{width} x {height}")
    return width, height


def turned_advice(image: Source, size: tuple[int, int], wanted: tuple[float, ...]) -> str:
    """Advice for an error, if an image would have the wanted size when rotated; "" if not."""
    if not all(abs(side - other) <= ROUNDING for side, other in zip(size, reversed(wanted))):
        return ""
    orientation = turned_by(image, READABLE[image.suffix.lower()]) if isinstance(image, Path) else None
    if orientation is None:
        return "is it the image of that camera, or turned on its side?"
    return (f"its EXIF data say that it is shown turned (orientation {orientation}), and its camera was calibrated so; "
            "pixels are read as stored: turn them, as PIL.ImageOps.exif_transpose does, and save the file")
