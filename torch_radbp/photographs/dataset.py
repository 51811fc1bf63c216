"""`Photographs`: a data set of images with the cameras that took them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.data import Dataset, default_collate
from typing_extensions import Unpack

from torch_radbp.formats.leniency import Repairs
from torch_radbp.formats.memory import memory_for
from torch_radbp.io.colmap import cameras_from_colmap
from torch_radbp.io.nerf import nerf_cameras
from torch_radbp.io.opencv import SensorAttributes, sensor_of
from torch_radbp.photographs.area_average import area_average
from torch_radbp.photographs.cameras import checked_size, named_as_in_a_scene, scaled_to_files
from torch_radbp.photographs.folders import colmap_pictures, nerf_pictures
from torch_radbp.photographs.image_cache import ImageCache
from torch_radbp.photographs.picture import Picture, as_source, background_colour, checked_curve, picture_name, read_picture
from torch_radbp.photographs.size_batches import SizeBatches
from torch_radbp.plugin import integer, nearest, positive
from torch_radbp.public_call import passing_on
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.sensor.kind import ProjectiveCamera

CACHE = 1 << 30  # bytes


class Photograph(NamedTuple):
    """One photograph, or a batch of B from a `DataLoader`.

    Attributes:
        image: (3, H, W) or (B, 3, H, W) float32, linear RGB.
        mask: (1, H, W) or (B, 1, H, W) float32 in [0, 1]: how much of each pixel counts.
        sensors: name of the sensor in the scene, or a tuple of B: what `renderer(sensors=)` takes.
        views: index of the photograph in the data set, or (B,) int64: what `Exposure` takes.
    """

    image: Tensor
    mask: Tensor
    sensors: str | tuple[str, ...]
    views: int | Tensor


class Photographs(Dataset[Photograph]):
    """Photographs with their cameras and masks.

        photographs = rb.Photographs.from_nerf("transforms.json")
        scene = rb.load_dict({"type": "scene", **photographs.cameras, **objects})
        renderer = rb.Renderer(scene, spp=16)
        for batch in torch.utils.data.DataLoader(photographs, batch_size=4, shuffle=True):
            rendering = renderer(seed=step, sensors=batch.sensors)  # (4, 3, H, W)

    Items are `Photograph`s. Images are linear: PNG and TIFF of 8 and 16 bits, JPEG, WebP, BMP and TGA are decoded by
    `curve`, EXR, HDR and PFM are linear already. An alpha channel is the mask, and the image is what is seen over
    `background`: colours are multiplied by alpha, but for those of EXR, which are already. A mask that is given besides
    multiplies that of alpha, and leaves the image as it is, but for NaN and infinity, which become 0 where it is 0. Alpha is
    cut to [0, 1], beyond which filters with negative lobes leave some. EXIF data, orientation included, are not read:
    calibrations go by the stored pixels.

    Overexposed pixels say only that there was more light: the mask is to be 0 there and two pixels around, as far as the
    film's filter spreads a lamp that is far brighter than white.

    Files are read when they are asked for; that they exist, and have the size that their cameras say, is checked at once.
    Photographs of several sizes cannot stand in one batch: `batches` keeps them apart.

    Args:
        images: paths, or tensors (3, H, W), which are linear.
        cameras: one for each image; a dict by name, as `rb.cameras_from_nerf` gives, or a list, whose cameras are called
            view_0, view_1, ... Dots in names become underscores, as in a scene.
        masks: paths, or tensors (1, H, W) in [0, 1] or of truth values, or None, one for each image; 1 counts, 0 does not.
            Of a file in colour the mean; no curve applies to it.
        curve: by which the values of files were coded: "srgb"; "linear"; or a gamma such as 2.2, linear = value^gamma. A
            curve that is not known is recovered: read the files as "linear" and apply an `rb.ToneCurve`.
        background: behind what alpha lets through; a number or (3,), linear. NeRF's white one is 1.
        cache_bytes: how much memory images that were read may take.

    Attributes:
        cameras: the sensors by the names that they have in a scene.
        names: their names, in order.

    Raises:
        ValueError: if numbers or sizes differ, a name is taken twice, the curve is not known, or a mask is not in [0, 1].
        TypeError: if a camera cannot take photographs, such as a `batch`, of which the sensors can.
        FileNotFoundError: if a file does not exist.
    """

    def __init__(self, images: Sequence[str | os.PathLike | Tensor], cameras: Mapping[str, ProjectiveCamera] | Sequence,
                 masks: Sequence[str | os.PathLike | Tensor | None] | None = None, *, curve: str | float = "srgb",
                 background: float | Sequence[float] = 0.0, cache_bytes: int = CACHE):
        self.curve, self.background = checked_curve(curve), background_colour(background)
        self.cache = ImageCache(integer("cache_bytes", cache_bytes, 0))
        named = cameras if isinstance(cameras, Mapping) else {f"view_{k}": camera for k, camera in enumerate(cameras)}
        self.cameras = named_as_in_a_scene(named)
        self.names = list(self.cameras)
        masks = [None] * len(images) if masks is None else masks
        if not len(images) == len(masks) == len(self.names) or not self.names:
            raise ValueError(f"there must be one camera, and one mask if any, for each image, got {len(images)} images, "
                             f"{len(self.names)} cameras and {len(masks)} masks")
        self.pictures = [
            Picture(as_source(f"images[{k}]", image, 3), None if mask is None else as_source(f"masks[{k}]", mask, 1))
            for k, (image, mask) in enumerate(zip(images, masks))]
        self.sizes = [checked_size(name, self.cameras[name], picture) for name, picture in zip(self.names, self.pictures)]

    @classmethod
    @passing_on(SensorAttributes.__annotations__, sensor_of)
    def from_nerf(cls, path: str | os.PathLike, *, images: str | os.PathLike | None = None,
                  masks: str | os.PathLike | None = None, scale: float = 1.0, curve: str | float = "srgb",
                  background: float | Sequence[float] = 0.0, cache_bytes: int = CACHE, missing: str = "skip",
                  width: int | None = None, height: int | None = None, strict: bool = False,
                  **attributes: Unpack[SensorAttributes]) -> Photographs:
        """Loads the photographs of a NeRF data set, as instant-ngp, nerfstudio and the Blender scenes write it.

        Args:
            path: of transforms.json; its `file_path`, which may lack the extension, and `mask_path` are relative to its
                folder.
            images: another folder with files of the same names, such as "images_4".
            masks: a folder of masks, as of `from_colmap`, in place of `mask_path`.
            scale: of the files, relative to the size that the cameras say: 0.25 for "images_4". To reduce them, take
                `at_scale`.
            curve, background, cache_bytes: as of `Photographs`.
            missing: what to do with frames whose image is not there: "skip" them, with a warning, or "error".
            strict: raise errors instead of warnings of what is left out or repaired.
            width, height, **attributes: as of `rb.cameras_from_nerf`.

        Raises:
            SceneError, ValueError, FileNotFoundError: as `rb.cameras_from_nerf` and `Photographs`.
        """
        with Repairs(strict):
            files = nerf_pictures(Path(path), images, masks, missing)
            cameras = nerf_cameras(Path(path), files, width=width, height=height, missing="error",
                                   **attributes)  # for each file one
            pictures = list(files.values())
        return cls([each.image for each in pictures], scaled_to_files(cameras, pictures, scale),
                   [each.mask for each in pictures], curve=curve, background=background, cache_bytes=cache_bytes)

    @classmethod
    @passing_on(SensorAttributes.__annotations__, sensor_of)
    def from_colmap(cls, folder: str | os.PathLike, images: str | os.PathLike, *, masks: str | os.PathLike | None = None,
                    scale: float = 1.0, curve: str | float = "srgb", background: float | Sequence[float] = 0.0,
                    cache_bytes: int = CACHE, missing: str = "skip",
                    strict: bool = False,
                    **attributes: Unpack[SensorAttributes]) -> Photographs:
        """Loads the photographs of a COLMAP model.

        Args:
            folder: of the model, such as "sparse/0".
            images: folder of the images; if none is there, they may be one folder further up or down, which is told.
            masks: folder of the masks: of view.jpg view.jpg.png, as COLMAP has it, view.png or view.jpg.
            scale: of the files, relative to the size that the cameras say: 0.25 for "images_4". To reduce them, take
                `at_scale`.
            curve, background, cache_bytes: as of `Photographs`.
            missing, strict: as of `from_nerf`.
            **attributes: as of `rb.cameras_from_colmap`.

        Raises:
            SceneError, ValueError, FileNotFoundError: as `rb.cameras_from_colmap` and `Photographs`.
        """
        with Repairs(strict):
            cameras = cameras_from_colmap(folder, **attributes)
            files = colmap_pictures(folder, cameras, images, masks, missing)
        cameras, pictures = {name: cameras[name] for name in files}, list(files.values())
        return cls([each.image for each in pictures], scaled_to_files(cameras, pictures, scale),
                   [each.mask for each in pictures], curve=curve, background=background, cache_bytes=cache_bytes)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> Photograph:
        view = integer("the index of a photograph", index)
        if not -len(self) <= view < len(self):
            raise IndexError(f"there are {len(self)} photographs, from 0 to {len(self) - 1}, got {index}")
        view %= len(self)
        image, mask = self.cache.get(view, lambda: self.read(view))
        return Photograph(image.clone(), mask.clone(), self.names[view], view)

    def read(self, view: int) -> tuple[Tensor, Tensor]:
        """Reads the image and mask of a photograph, at the current size of its camera's film.

        Raises:
            ValueError: if its file has another size than when the data set was made, and as `read_picture`.
            MemoryError: names the file, if there is not enough memory.
        """
        picture = self.pictures[view]
        with memory_for(picture_name(picture.image)):
            image, mask = read_picture(picture, self.curve, self.background)
            return self.at_size(view, image, mask)

    def at_size(self, view: int, image: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Resizes image and mask from the file's size to the current size of the camera's film."""
        picture = self.pictures[view]
        if (size := (image.shape[2], image.shape[1])) != self.sizes[view]:
            was = self.sizes[view]
            raise ValueError(f"{picture_name(picture.image)} has {size[0]} x {size[1]} pixels now, and had {was[0]} x "
                             f"{was[1]} when these photographs were made; make them anew")
        film = self.cameras[self.names[view]].film
        return tuple(area_average(part, film.crop_width, film.crop_height) for part in (image, mask))

    def at_scale(self, scale: float) -> Photographs:
        """The same photographs with images and cameras of another size: a level of a resolution pyramid.

        Pixels are averages over areas, of linear values. Cameras share their pose with those here and have intrinsics
        that follow from the values now, so that what has been refined at a small size goes on at a larger one:

            for scale in (0.25, 0.5, 1):
                photographs = photographs.at_scale(scale)
                photographs.place_cameras(scene)
                ...

        Intrinsics are other parameters at each scale: an optimizer that holds them is made anew.

        Args:
            scale: of the files: 0.5 for half of their width and height, rounded to whole pixels; at most 1.

        Raises:
            ValueError: if the scale is not in (0, 1], or a camera cannot be resized, see `ProjectiveCamera.resized`.
        """
        if positive("scale", scale) > 1:
            raise ValueError(f"scale must be at most 1, the size of the files, got {scale}")
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        sizes = [[max(1, round(side * scale)) for side in size] for size in self.sizes]
        other.cameras = {name: camera.resized(*size) for (name, camera), size in zip(self.cameras.items(), sizes)}
        other.cache = ImageCache(self.cache.limit)
        return other

    def place_cameras(self, scene: Scene) -> None:
        """Replaces the cameras of a scene that have the same names.

        Raises:
            ValueError: if a name is not that of a sensor of the scene.
        """
        sensors = scene.named_sensors
        for name in self.names:
            if name not in sensors:
                raise ValueError(f"the scene has no sensor {name!r} to put a camera in the place of; "
                                 f"{nearest(name, sensors)}")
        for name, camera in self.cameras.items():
            setattr(scene, name, camera.to(scene.device, scene.dtype))

    def batches(self, batch_size: int, shuffle: bool = True, generator: torch.Generator | None = None) -> SizeBatches:
        """Batches of photographs of one size each, for data sets with several sizes:

            batches = photographs.batches(4)
            loader = torch.utils.data.DataLoader(photographs, batch_sampler=batches)

        Args:
            batch_size, shuffle, generator: as of a `DataLoader`.
        """
        return SizeBatches(self.sizes, batch_size, shuffle, generator)

    def batch(self, views: Iterable[int] | None = None) -> Photograph:
        """Some photographs, or all, in one batch.

        Args:
            views: their indices; None: all.

        Raises:
            ValueError: if they have several sizes.
        """
        return collate([self[view] for view in (range(len(self)) if views is None else views)])


def collate(photographs: list[Photograph]) -> Photograph:
    """Stacks photographs to a batch, for a `DataLoader`.

    Raises:
        ValueError: if there is none, or they have several sizes.
    """
    sizes = {tuple(each.image.shape[1:]) for each in photographs}
    if len(sizes) != 1:
        raise ValueError(f"a batch must have photographs of one size, (height, width), got {sorted(sizes)}")
    return default_collate(photographs)
