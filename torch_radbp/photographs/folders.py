"""Finds the image and mask files of a data set."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from torch_radbp.formats.leniency import Repairs
from torch_radbp.io.nerf import frames_of, image_file, is_file, left_out, missing_of, read_json
from torch_radbp.photographs.picture import Picture
from torch_radbp.plugin import SceneError

Find = Callable[[Path, str], Path | None]  # the file of a name in a folder


def colmap_pictures(model: str | os.PathLike, names: Iterable[str], images: str | os.PathLike,
                    masks: str | os.PathLike | None, missing: str) -> dict[str, Picture]:
    """The image and mask files of a COLMAP model, by names; without missing ones.

    Args:
        model: its folder, for messages.
        names: of the images, relative to their folder.
        images, masks: folders.
        missing: as of `Photographs.from_colmap`.

    Raises:
        FileNotFoundError: names a mask that is not there, an image if they must be, or the folder if there is none.
        ValueError: if images may be in several folders.
    """
    names = list(names)
    files = files_of(model, names, [(Path(images), names)], file_in, missing)
    return {name: Picture(file, None if masks is None else mask_of(masks, name)) for name, file in files.items()}


def nerf_pictures(path: Path, images: str | os.PathLike | None, masks: str | os.PathLike | None,
                  missing: str) -> dict[str, Picture]:
    """The image and mask files of the frames of transforms.json, by names and in its order; without missing ones.

    Arguments as of `Photographs.from_nerf`.

    Raises:
        SceneError: if a frame's file_path or mask_path is none.
        FileNotFoundError: names a mask that is not there, an image if they must be, or the folder if there is none.
        ValueError: if images may be in several folders, or two frames have one.
    """
    frames = {frame.name: frame for frame in frames_of(path, read_json(path))}
    names = list(frames)
    said = [(path.parent, names)]
    if images is not None:
        said = [(Path(images), [without_first(name) for name in names]), (Path(images), [Path(name).name for name in names]),
                (Path(images), names)]
    pictures = {}
    for name, image in files_of(path, names, said, image_file, missing).items():
        mask = frames[name].entry.get("mask_path")
        if mask is not None and not isinstance(mask, str):
            raise SceneError(f"{frames[name].place}.mask_path: must be the name of the mask, got {mask!r:.80}")
        if masks is not None:
            mask_file = mask_of(masks, image.name)
        else:
            mask_file = None if mask is None else present(path.parent / mask, "the mask", mask)
        pictures[name] = Picture(image, mask_file)
    return pictures


def files_of(path: str | os.PathLike, names: Sequence[str], said: Sequence[tuple[Path, Sequence[str]]], find: Find,
             missing: str) -> dict[str, Path]:
    """Finds image files by name, in the first folder that has at least one of them.

    Args:
        path: of the data set, for messages.
        names: of the images.
        said: folders, and the names that images have there; if none has any, the same with one folder more or less.
        find: the file of a name in a folder.
        missing: "skip" or "error", for images that are not there.

    Raises:
        FileNotFoundError: if none is there, or one if they must be.
        ValueError: if an image may be in several folders, or two images are one file.
    """
    missing_of(missing)
    folder, first = said[0]
    others = [(folder.parent, first), (folder, [without_first(name) for name in first])]
    there = first_with_any(said, find)
    elsewhere = there is None
    if there is None:
        there = first_with_any(others, find) or [below(folder, name, find) for name in first]
    files = {name: file for name, file in zip(names, there) if file is not None}
    if not files:
        raise FileNotFoundError(f"{path}: none of its {len(names)} images is there; looked for {first[0]} in {folder}, one "
                                f"folder up and one down")
    absent = [name for name in names if name not in files]
    if absent and missing == "error":
        raise FileNotFoundError(f"{folder / absent[0]}: file not found, the image {absent[0]!r} of the data set")
    with Repairs() as repairs:
        if elsewhere:
            repairs.add(str(next(iter(files.values())).parent), f"images of {path} are read there, none is in {folder}")
        for name in absent:
            repairs.add(name, left_out(path))
    if len(set(files.values())) < len(files):
        one, other = next((a, b) for a in files for b in files if a < b and files[a] == files[b])
        raise ValueError(f"{path}: the images {one} and {other} are one file, {files[one]}; give a folder that has both")
    return files


def first_with_any(places: Iterable[tuple[Path, Sequence[str]]], find: Find) -> list[Path | None] | None:
    """The files in the first of some folders that has any of the names; None if none has."""
    tried = ([find(folder, name) for name in names] for folder, names in places)
    return next((files for files in tried if any(files)), None)


def below(folder: Path, name: str, find: Find) -> Path | None:
    """The file of a name in the only subfolder of `folder` that has it.

    Raises:
        ValueError: if several have it.
    """
    if not folder.is_dir():
        return None
    folders = sorted(entry for entry in folder.iterdir() if entry.is_dir())
    files = [file for file in (find(each, name) for each in folders) if file is not None]
    if len(files) > 1:
        raise ValueError(f"the image {name} is not in {folder}, and in {files[0].parent} and "
                         f"{files[1].parent}; which is it?")
    return files[0] if files else None


def without_first(name: str) -> str:
    """A relative path without its first folder."""
    _, _, rest = name.replace("\\", "/").partition("/")
    return rest or name


def file_in(folder: Path, name: str) -> Path | None:
    """The file with exactly this name in a folder; None: there is none."""
    return folder / name if is_file(folder / name) else None


def mask_of(folder: str | os.PathLike, name: str) -> Path:
    """The mask file of an image: view.jpg.png, view.png or view.jpg in the folder of masks.

    Raises:
        FileNotFoundError: if there is none; it lists where it was looked for.
    """
    tried = [Path(folder) / f"{name}.png", (Path(folder) / name).with_suffix(".png"), Path(folder) / name]
    mask = next((path for path in tried if path.is_file()), None)
    if mask is None:
        raise FileNotFoundError(f"the image {name} has no mask; looked for {', '.join(map(str, tried))}")
    return mask


def present(path: Path, what: str, name: str) -> Path:
    """`path` if that file exists, else raises FileNotFoundError."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: file not found, {what} {name!r} of the data set")
    return path
