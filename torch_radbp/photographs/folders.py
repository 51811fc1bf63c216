"""Where the images and masks of a data set lie."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from torch_radbp.io.nerf import image_of, read_json
from torch_radbp.photographs.picture import Picture
from torch_radbp.plugin import SceneError


def colmap_pictures(names: Iterable[str], images: str | os.PathLike, masks: str | os.PathLike | None) -> list[Picture]:
    """The files of the images of a COLMAP model.

    Args:
        names: of the images, relative to their folder.
        images, masks: folders.

    Raises:
        FileNotFoundError: names an image or a mask that is not there.
    """
    return [Picture(present(Path(images) / name, "the image", name), None if masks is None else mask_of(masks, name))
            for name in names]


def nerf_pictures(path: str | os.PathLike, images: str | os.PathLike | None,
                  masks: str | os.PathLike | None) -> list[Picture]:
    """The files of the frames of transforms.json, in its order; arguments as of `Photographs.from_nerf`.

    Raises:
        SceneError: if a frame's file_path or mask_path is none.
        FileNotFoundError: names an image or a mask that is not there.
    """
    path = Path(path)
    frames = read_json(path).get("frames")
    pictures = []
    for number, frame in enumerate(frames if isinstance(frames, list) else []):
        place = f"{path}: frames[{number}]"
        name, mask = (frame.get(key) if isinstance(frame, dict) else None for key in ("file_path", "mask_path"))
        if not isinstance(name, str) or not name:
            raise SceneError(f"{place}.file_path: must be the name of the image, got {name!r:.80}")
        if mask is not None and not isinstance(mask, str):
            raise SceneError(f"{place}.mask_path: must be the name of the mask, got {mask!r:.80}")
        folder = path.parent if images is None else Path(images)
        name = name if images is None else Path(name).name
        image = image_of(folder, name) or present(folder / name, "the image", name)
        if masks is not None:
            pictures.append(Picture(image, mask_of(masks, image.name)))
        else:
            pictures.append(Picture(image, None if mask is None else present(path.parent / mask, "the mask", mask)))
    return pictures


def mask_of(folder: str | os.PathLike, name: str) -> Path:
    """The mask of an image: view.jpg.png, view.png or view.jpg in the folder of masks.

    Raises:
        FileNotFoundError: if there is none; it lists where it was looked for.
    """
    tried = [Path(folder) / f"{name}.png", (Path(folder) / name).with_suffix(".png"), Path(folder) / name]
    found = next((path for path in tried if path.is_file()), None)
    if found is None:
        raise FileNotFoundError(f"the image {name} has no mask; looked for {', '.join(map(str, tried))}")
    return found


def present(path: Path, what: str, name: str) -> Path:
    """`path`, if there is such a file."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: file not found, {what} {name!r} of the data set")
    return path
