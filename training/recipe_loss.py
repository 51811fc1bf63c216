"""The tables of a recipe's `[[loss]]`."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from torch_radbp.training.recipe_values import Count, Number, Positive, Table


class Loss(Table):
    weight: Positive = 1.0


class TwoBufferL2(Loss):
    """mean((I_a - T)(I_b - T)) of two independent renderings: unbiased at any spp, so it takes no tone mapping."""

    name: Literal["two_buffer_l2"]


class ImageLoss(Loss):
    windowed: ClassVar[bool] = False  # compares neighbourhoods of pixels

    tone_mapping: Literal["none", "log1p", "srgb"] = "none"


class L1(ImageLoss):
    name: Literal["l1"]


class L2(ImageLoss):
    name: Literal["l2"]


class SSIM(ImageLoss):
    """kornia's (1 - SSIM) / 2."""

    windowed: ClassVar[bool] = True

    name: Literal["ssim"]
    window: Count = 11
    max_value: Positive = 1.0

    @model_validator(mode="after")
    def _check_window(self):
        if self.window % 2 == 0:
            raise ValueError(f"window must be odd, got {self.window}")
        return self


class MultiScaleSSIM(ImageLoss):
    """kornia's MS_SSIMLoss: alpha * (1 - MS-SSIM) + (1 - alpha) * L1 under the coarsest Gaussian."""

    windowed: ClassVar[bool] = True

    name: Literal["ms_ssim"]
    alpha: Number = Field(0.84, ge=0, le=1)
    max_value: Positive = 1.0
    sigmas: list[Positive] = Field([0.5, 1.0, 2.0, 4.0, 8.0], min_length=1)


AnyLoss = Annotated[TwoBufferL2 | L1 | L2 | SSIM | MultiScaleSSIM, Field(discriminator="name")]
