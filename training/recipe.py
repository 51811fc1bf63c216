"""The schema of recipes: one pydantic model per TOML table. Reading and writing is in `recipe_file`."""

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    model_validator,
)

from torch_radbp.rendering.memory import parse_budget
from torch_radbp.training.device import parse_device
from torch_radbp.training.recipe_values import (
    LARGEST,
    Count,
    Fraction,
    Number,
    Positive,
    RecipePath,
    Switch,
    Table,
    Value,
    Whole,
    Whole64,
)

MOST_WEIGHTS = 1 << 24  # of a network; gradients and moments are as many each
WIDEST = 1 << 12  # waves of a network, or width: each place where it is read has so many values


class Target(Table):
    """One photograph, and the sensor that took it (may be left out if the scene has one sensor)."""

    image: RecipePath
    sensor: str | None = None


Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]


class Offset(Table):
    """An initial pose: that of the scene file, turned about its own origin, then moved, both along world axes."""

    rotation: Vector = [0.0, 0.0, 0.0]  # rotation vector: axis times angle in degrees
    translation: Vector = [0.0, 0.0, 0.0]


# The name of a union's branch in the places of pydantic's errors; no key of a table.
VALUE, OFFSET = "<value>", "<offset>"
Initial = Annotated[
    Annotated[Value, Tag(VALUE)] | Annotated[Offset, Tag(OFFSET)],
    Discriminator(lambda given: OFFSET if isinstance(given, (dict, Offset)) else VALUE),
]


class Network(Table):
    """A network from surface coordinates to colours; see `recovery.network`."""

    waves: Count = 64  # random sines and cosines of the coordinates, which it gets in their place
    frequency: Positive = 20.0  # their standard deviation, radians per width of the bitmap
    layers: Count = 2  # hidden ones
    width: Count = 64  # of these
    seed: Whole = Field(0, ge=0)  # of waves and initial weights

    @property
    def weights(self) -> int:
        """About how many there are: the last layer has a few more."""
        return 2 * self.waves * self.width + (self.layers - 1) * self.width**2

    @model_validator(mode="after")
    def _check_size(self):
        if max(self.waves, self.width) > WIDEST:
            raise ValueError(f"waves = {self.waves} and width = {self.width}: at most {WIDEST} each are taken, since every "
                             f"place has so many values")
        if self.weights > MOST_WEIGHTS:
            raise ValueError(f"waves = {self.waves}, layers = {self.layers} and width = {self.width} make {self.weights} "
                             f"weights; at most {MOST_WEIGHTS} are taken: choose fewer waves or layers, or a smaller width")
        return self


class Parameter(Table):
    """Parameters to recover: a name as `radbp info` prints it, or a glob such as `*.reflectance.value`."""

    name: str
    initial: Initial | None = None  # None: the value in the scene file
    bounds: tuple[Number, Number] | None = None
    learning_rate: Positive | None = None  # None: the optimiser's
    # How the bounds are kept: projected back after every step, or never left because a sigmoid (log) of the
    # parameter is what the optimiser sees. "rigid" is for (4, 4) matrices, which have no bounds: the optimiser sees a
    # rotation vector (radians) and a translation, see `rigid`. "network" is for bitmaps: a network takes the place of one,
    # within the bounds by a sigmoid, and the optimiser sees its weights.
    parametrisation: Literal["clamp", "sigmoid", "log", "rigid", "network"] = "clamp"
    network: Network | None = None  # None: of the default size
    truth: Literal["scene"] | Value | None = None  # for reports only; "scene": the value in the scene file

    @model_validator(mode="after")
    def _check_bounds(self):
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            raise ValueError(f"bounds must be [lower, upper] with lower < upper, got {list(self.bounds)}")
        if self.parametrisation in ("sigmoid", "network") and self.bounds is None:
            raise ValueError(f'parametrisation = "{self.parametrisation}" needs bounds = [lower, upper]')
        if self.parametrisation == "network" and self.initial is not None:
            raise ValueError("a network begins with random weights and takes no initial value; its network = { seed = 1 } "
                             "draws others")
        if self.network is not None and self.parametrisation != "network":
            raise ValueError(f'network = ... needs parametrisation = "network", got "{self.parametrisation}"')
        if self.parametrisation == "log" and self.bounds is not None:
            raise ValueError('parametrisation = "log" keeps a value positive and takes no bounds')
        if self.parametrisation == "rigid" and self.bounds is not None:
            raise ValueError('parametrisation = "rigid" is a rotation and a translation and takes no bounds')
        if isinstance(self.initial, Offset) and self.parametrisation != "rigid":
            raise ValueError('initial = { rotation = ..., translation = ... } needs parametrisation = "rigid"')
        return self


class Adjoint(Table):
    """The strategy of the backward pass; see the table in docs/memory.md."""

    strategy: Literal["memoized", "replay", "quadratic", "tape"] = "memoized"
    stride: Count | Literal["sqrt", "log"] = 1
    keep_hits: Switch = True

    @model_validator(mode="after")
    def _check_options(self):
        if self.strategy != "memoized" and self.model_fields_set & {"stride", "keep_hits"}:
            raise ValueError(f'stride and keep_hits belong to strategy = "memoized", not to {self.strategy!r}')
        return self


def _check_budget(budget: int | str) -> int | str:
    parse_budget(budget)
    return budget


def _check_device(name: str) -> str:
    parse_device(name)
    return name


class Render(Table):
    """Arguments of `torch_radbp.Renderer`; what is left out is taken from the scene file."""

    spp: Count = 16  # samples per pixel of a step's image; two_buffer_l2 renders two, other losses one in two halves
    max_depth: Whole | None = Field(None, ge=-1)
    rr_depth: Count | None = None
    adjoint: Adjoint | None = None  # None: memoized, with the stride that memory_budget leaves room for, else 1
    sampling: str = "hybrid"
    chunk: Count | None = None
    memory_budget: Annotated[Whole64 | str, AfterValidator(_check_budget)] | None = None  # bytes, "2GiB" or "2GB"
    compile: Switch = True  # False: in plain torch, slower; nothing is compiled
    caster: str | None = None
    # What gradients are made of: "interior", "primary" (curves at which the image jumps), "shadow" (borders of shadows).
    terms: Annotated[list[str], Field(min_length=1)] | None = None  # None: all
    device: Annotated[str, AfterValidator(_check_device)] | None = None  # "cpu", "cuda" or "cuda:1"; None: the CPU
    seed: Whole = Field(0, ge=0)


class Loss(Table):
    weight: Positive = 1.0


class TwoBufferL2(Loss):
    """mean((I_a - T)(I_b - T)) of two independent renderings: unbiased at any spp, so it takes no tone mapping."""

    name: Literal["two_buffer_l2"]


class ImageLoss(Loss):
    tone_mapping: Literal["none", "log1p", "srgb"] = "none"


class L1(ImageLoss):
    name: Literal["l1"]


class L2(ImageLoss):
    name: Literal["l2"]


class SSIM(ImageLoss):
    """kornia's (1 - SSIM) / 2."""

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

    name: Literal["ms_ssim"]
    alpha: Number = Field(0.84, ge=0, le=1)
    max_value: Positive = 1.0
    sigmas: list[Positive] = Field([0.5, 1.0, 2.0, 4.0, 8.0], min_length=1)


AnyLoss = Annotated[TwoBufferL2 | L1 | L2 | SSIM | MultiScaleSSIM, Field(discriminator="name")]


class Optimizer(Table):
    learning_rate: Positive = 0.01


class Adam(Optimizer):
    name: Literal["adam"] = "adam"
    betas: tuple[Fraction, Fraction] = (0.9, 0.999)
    eps: Positive = 1e-8


class SGD(Optimizer):
    name: Literal["sgd"]
    momentum: Number = Field(0.0, ge=0, lt=1)
    nesterov: Switch = False

    @model_validator(mode="after")
    def _check_nesterov(self):
        if self.nesterov and not self.momentum:
            raise ValueError("nesterov = true needs a momentum above 0")
        return self


class RMSprop(Optimizer):
    name: Literal["rmsprop"]
    alpha: Number = Field(0.99, gt=0, lt=1)
    momentum: Number = Field(0.0, ge=0, lt=1)
    eps: Positive = 1e-8


AnyOptimizer = Annotated[Adam | SGD | RMSprop, Field(discriminator="name")]


class Constant(Table):
    name: Literal["constant"] = "constant"


class Cosine(Table):
    """From 1 down to `final` over all steps."""

    name: Literal["cosine"]
    final: Number = Field(0.0, ge=0, le=1)


class Step(Table):
    """Times `factor` every `every` steps."""

    name: Literal["step"]
    every: Count
    factor: Positive = 0.5


class Exponential(Table):
    """From 1 down to `final` over all steps, by the same factor each step."""

    name: Literal["exponential"]
    final: Positive = 0.1


AnySchedule = Annotated[Constant | Cosine | Step | Exponential, Field(discriminator="name")]


class Report(Table):
    spp: Count = 1024  # of the before and after images at most: they end where no noise is seen
    checkpoint_every: Count = 50


def _check_variables(variables: Any) -> Any:
    if isinstance(variables, dict) and "allow_outside" in variables:
        raise ValueError("a recipe cannot allow files outside of the folder of its scene; pass --allow-outside")
    return variables


class Recipe(Table):
    """A whole recipe. Paths are absolute once read."""

    FILE_NAME: ClassVar[str] = "recipe.toml"

    title: str = ""
    description: str = ""
    scene: RecipePath
    # Of the scene file, as in rb.load(path, resolution=128).
    variables: Annotated[dict[str, str | Whole | Number], BeforeValidator(_check_variables)] = {}
    steps: Count
    targets: list[Target] = Field(min_length=1)
    parameters: list[Parameter] = Field(min_length=1)
    render: Render = Render()
    loss: list[AnyLoss] = Field(default_factory=lambda: [TwoBufferL2(name="two_buffer_l2")], min_length=1)
    optimizer: AnyOptimizer = Adam()
    schedule: AnySchedule = Constant()
    report: Report = Report()

    @model_validator(mode="after")
    def _check_learning_rates(self):
        if isinstance(self.schedule, Step):
            rates = [self.optimizer.learning_rate, *(each.learning_rate for each in self.parameters if each.learning_rate)]
            times = (self.steps - 1) // self.schedule.every
            largest = math.log10(max(rates)) + times * math.log10(self.schedule.factor)
            if largest > math.log10(LARGEST):
                raise ValueError(f"a schedule.factor of {self.schedule.factor:g}, {times} times, makes a learning rate of "
                                 f"1e{largest:.0f} by the last step, and the most is {LARGEST:g}; lower the factor")
        return self
