"""Reads the images of a glTF document: PNG and JPEG, in files, data URIs and buffers."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image, UnidentifiedImageError

from torch_radbp.formats.image import SIGNATURES
from torch_radbp.formats.pillow import open_picture
from torch_radbp.formats.png import check_pixel_data
from torch_radbp.io.gltf.accessor import Buffers
from torch_radbp.io.gltf.document import Document, DocumentPart

KINDS = ("PNG", "JPEG")  # by their first bytes; what mimeType and file names say does not count
MAX_TEXELS = 2**28  # of all images together


class Pictures:
    """The images of a document, decoded once."""

    def __init__(self, document: Document, buffers: Buffers):
        self.document, self.buffers = document, buffers
        self.cached: dict[int, np.ndarray] = {}
        self.texels = 0  # so far

    def pixels(self, index: int, user: DocumentPart) -> np.ndarray:
        """(H, W, 4) bytes of an image as they are coded, alpha last; row 0 is at the top."""
        if index not in self.cached:
            part = self.document.of("images", index, user, "source")
            uri = part.text("uri", None)
            content = (self.buffers.resource(uri, part) if uri is not None
                       else bytes(self.buffers.view(part.integer("bufferView"), part)[0]))
            self.cached[index] = self.decoded(content, part)
        return self.cached[index]

    def decoded(self, content: bytes, part: DocumentPart) -> np.ndarray:
        """Decodes a PNG or JPEG to (H, W, 4) bytes, the high ones of 16 bits."""
        kind = next((kind for kind in KINDS if content.startswith(SIGNATURES[kind])), None)
        if kind is None:
            raise part.fail(f"an image must be PNG or JPEG, this one begins with {content[:8]!r}")
        try:
            with open_picture(io.BytesIO(content), kind, len(content)) as image:
                self.texels += image.size[0] * image.size[1]
                image.verify()
            if self.texels > MAX_TEXELS:
                raise ValueError(f"the images have more than {MAX_TEXELS} pixels together")
            if kind == "PNG":
                check_pixel_data(io.BytesIO(content))
            with open_picture(io.BytesIO(content), kind, len(content)) as image:
                return bytes_of(image)
        except MemoryError:
            raise
        except Exception as error:  # the library raises whatever its decoders stumble over
            # Their messages speak of their own code.
            inner = isinstance(error, (LookupError, ArithmeticError, UnicodeError, UnidentifiedImageError))
            reason = "its content is damaged" if inner else " ".join(str(error).split())
            raise part.fail(f"cannot be read as {kind}: {reason}") from error


def bytes_of(image: Image.Image) -> np.ndarray:
    """(H, W, 4) bytes of an image as they are coded, alpha last; the high ones of 16 bits."""
    if image.mode.startswith("I"):  # 16 bits of grey, which `convert` would cut off
        grey = (np.array(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
        return np.stack([grey, grey, grey, np.full_like(grey, 255)], axis=2)
    return np.array(image.convert("RGBA"))
