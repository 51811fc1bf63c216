"""The film: size, crop window and reconstruction filter."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.film.gaussian import Gaussian
from torch_radbp.film.position import FilmTensors
from torch_radbp.plugin import Film, ReconstructionFilter, boolean, integer, nearest, register

PIXEL_FORMATS, COMPONENT_FORMATS, FILE_FORMATS = ("rgb", "rgba"), ("float16", "float32", "uint32"), ("openexr",)


@register("film", "hdrfilm")
class HDRFilm(Film):
    """A linear RGB image.

    Args:
        width, height: of the whole image, pixels.
        crop_offset_x, crop_offset_y, crop_width, crop_height: the window that is rendered; by default the whole image.
        sample_border: let pixels at the border of the window use samples from outside it.
        pixel_format: rgb, or rgba: then `radbp render` writes an alpha channel, and `renderer.aovs(["alpha"])` gives it.
        component_format, file_format, banner: of the files that Mitsuba writes; without effect here.
        rfilter: box, tent, gaussian, mitchell, catmullrom or lanczos; Gaussian by default.
    """

    def __init__(self, *, width: int = 768, height: int = 576, crop_offset_x: int = 0, crop_offset_y: int = 0,
                 crop_width: int | None = None, crop_height: int | None = None, sample_border: bool = False,
                 pixel_format: str = "rgb", component_format: str = "float16", file_format: str = "openexr",
                 banner: bool = True, rfilter: ReconstructionFilter | None = None):
        super().__init__()
        self.width, self.height = integer("width", width), integer("height", height)
        self.crop_offset_x = integer("crop_offset_x", crop_offset_x)
        self.crop_offset_y = integer("crop_offset_y", crop_offset_y)
        self.crop_width = self.width - self.crop_offset_x if crop_width is None else integer("crop_width", crop_width)
        self.crop_height = self.height - self.crop_offset_y if crop_height is None else integer("crop_height", crop_height)
        for name in ("width", "height", "crop_width", "crop_height"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if (min(self.crop_offset_x, self.crop_offset_y) < 0 or self.crop_offset_x + self.crop_width > self.width
                or self.crop_offset_y + self.crop_height > self.height):
            raise ValueError(f"the crop window {self.crop_width} x {self.crop_height} at ({crop_offset_x}, {crop_offset_y}) "
                             f"must lie inside the image of {width} x {height}")
        for name, value, known in (("pixel_format", pixel_format, PIXEL_FORMATS),
                                   ("component_format", component_format, COMPONENT_FORMATS),
                                   ("file_format", file_format, FILE_FORMATS)):
            if value not in known:
                raise ValueError(f"{name} {value!r} is not supported; {nearest(value, known)}")
        self.sample_border, self.pixel_format = boolean("sample_border", sample_border), pixel_format
        self.component_format, self.file_format, self.banner = component_format, file_format, boolean("banner", banner)
        self.rfilter = Gaussian() if rfilter is None else rfilter

    def border(self) -> int:
        """How many pixels around the window have samples, too, on each side."""
        return self.rfilter.kernel().reach if self.sample_border else 0

    def sampled(self) -> tuple[int, int]:
        """Columns and rows of the pixels that have samples."""
        return self.crop_width + 2 * self.border(), self.crop_height + 2 * self.border()

    def tensors(self, like: Tensor) -> FilmTensors:
        """What decides the places of samples and what they count; `like` gives dtype and device."""
        numbers = self.width, self.height, self.crop_offset_x, self.crop_offset_y
        kernel = self.rfilter.kernel()
        border = self.border()
        inside = (kernel.inside(size, border).to(like) for size in (self.crop_width, self.crop_height))
        size = (like.new_tensor(pixels, dtype=torch.int32) for pixels in (self.crop_width, self.crop_height))
        return FilmTensors(*(like.new_tensor(float(number)) for number in numbers), kernel, border, *inside, *size)
