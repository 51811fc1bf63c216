"""The film: size, crop window and reconstruction filter."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from torch_radbp.film.gaussian import Gaussian
from torch_radbp.film.position import FilmTensors
from torch_radbp.film.window import Span, Window
from torch_radbp.plugin import Film, ReconstructionFilter, boolean, integer, nearest, register
from torch_radbp.tensors.vec import Vec2

PIXEL_FORMATS, COMPONENT_FORMATS, FILE_FORMATS = ("rgb", "rgba"), ("float16", "float32", "uint32"), ("openexr",)


@register("film", "hdrfilm")
class HDRFilm(Film):
    """A film for linear RGB images.

    Args:
        width, height: of the whole image, pixels.
        crop_offset_x, crop_offset_y, crop_width, crop_height: the window that is rendered; by default the whole image right
            of the offset and below it, also after `width` or `height` were assigned.
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
        self._crop_width = None if crop_width is None else integer("crop_width", crop_width)
        self._crop_height = None if crop_height is None else integer("crop_height", crop_height)
        self.require_window_inside()
        for name, value, supported in (("pixel_format", pixel_format, PIXEL_FORMATS),
                                       ("component_format", component_format, COMPONENT_FORMATS),
                                       ("file_format", file_format, FILE_FORMATS)):
            if value not in supported:
                raise ValueError(f"{name} {value!r} is not supported; {nearest(value, supported)}")
        self.sample_border, self.pixel_format = boolean("sample_border", sample_border), pixel_format
        self.component_format, self.file_format, self.banner = component_format, file_format, boolean("banner", banner)
        self.rfilter = Gaussian() if rfilter is None else rfilter

    @property
    def crop_width(self) -> int:
        """The columns of the crop window."""
        return self.width - self.crop_offset_x if self._crop_width is None else self._crop_width

    @crop_width.setter
    def crop_width(self, columns: int | None) -> None:
        self._crop_width = columns

    @property
    def crop_height(self) -> int:
        """The rows of the crop window."""
        return self.height - self.crop_offset_y if self._crop_height is None else self._crop_height

    @crop_height.setter
    def crop_height(self, rows: int | None) -> None:
        self._crop_height = rows

    def require_window_inside(self) -> None:
        """Raises a ValueError unless the crop window has pixels, and the image has all of them."""
        for name in ("width", "height", "crop_width", "crop_height"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        x, y = self.crop_offset_x, self.crop_offset_y
        if min(x, y) < 0 or x + self.crop_width > self.width or y + self.crop_height > self.height:
            raise ValueError(f"the crop window {self.crop_width} x {self.crop_height} at ({x}, {y}) must lie inside the "
                             f"image of {self.width} x {self.height}")

    def border(self) -> int:
        """The number of pixels around the crop window, on each side, that have samples, too."""
        return self.rfilter.kernel().reach if self.sample_border else 0

    def window(self, part: tuple[int, int, int, int] | None = None) -> Window:
        """The pixels of a part of the crop window; `part`: x, y, width and height of it, counted there; None: all.

        Raises:
            ValueError: if the crop window does not lie in the image.
        """
        self.require_window_inside()
        x, y, width, height = (0, 0, self.crop_width, self.crop_height) if part is None else part
        border, reach = self.border(), self.rfilter.kernel().reach
        return Window(Span.within(self.crop_offset_x, self.crop_width, border, x, width, reach),
                      Span.within(self.crop_offset_y, self.crop_height, border, y, height, reach),
                      self.crop_width + 2 * border)

    def tensors(self, like: Tensor, window: Window | None = None) -> FilmTensors:
        """The film as tensors: positions of samples, and their weights in pixels.

        Args:
            like: gives dtype and device.
            window: what is rendered; None: the whole crop window.
        """
        window = self.window() if window is None else window
        kernel, border, spans = self.rfilter.kernel(), self.border(), window[:2]

        def numbers(*values: int) -> tuple[Tensor, ...]:
            return tuple(like.new_tensor(float(value)) for value in values)

        def counts(values: Iterable[int]) -> tuple[Tensor, ...]:
            return tuple(like.new_tensor(value, dtype=torch.int32) for value in values)

        return FilmTensors(
            *numbers(self.width, self.height), *numbers(*(span.first for span in spans)),
            Vec2(*numbers(self.crop_offset_x - border, self.crop_offset_y - border)), kernel,
            Vec2(*counts(span.before for span in spans)), Vec2(*counts(span.after for span in spans)),
            *(kernel.inside(span).to(like) for span in spans), *counts(span.size for span in spans))
