"""The schema of recipes: one pydantic model per TOML table. Reading and writing is in `recipe_file`."""

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from torch_radbp.rendering.memory import parse_budget
from torch_radbp.training.device import parse_device
from torch_radbp.training.recipe_loss import AnyLoss, TwoBufferL2
from torch_radbp.training.recipe_optimizer import Adam, AnyOptimizer, AnySchedule, Constant, GaussNewton, Step
from torch_radbp.training.recipe_parameter import Gains, Group, Parameter
from torch_radbp.training.recipe_values import LARGEST, Count, Number, Positive, RecipePath, Switch, Table, Whole, Whole64

SQUARES = ("two_buffer_l2", "l2")  # losses that are sums of squares


class Target(Table):
    """One photograph, and the sensor that took it (may be left out if the scene has one sensor)."""

    image: RecipePath
    sensor: str | None = None
    mask: RecipePath | None = None  # grey: how much of each pixel counts, black is nothing; None: all of it


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
    light_paths: Literal["camera", "caustics", "all", "auto"] | None = None  # which light comes by paths that begin at lamps
    device: Annotated[str, AfterValidator(_check_device)] | None = None  # "cpu", "cuda" or "cuda:1"; None: the CPU
    seed: Whole = Field(0, ge=0)


class Prior(Table):
    """What is likely of a parameter, before any image is seen: `weight` times a function of `rb.priors`."""

    name: Literal["total_variation", "bending", "smoothness", "white_balance"]
    parameter: str  # name or glob, of recovered parameters; or "gains"
    weight: Positive
    epsilon: Positive | None = None  # of total_variation and bending: differences below count by their squares; None: 0.001

    @model_validator(mode="after")
    def _check_epsilon(self):
        if self.epsilon is not None and self.name not in ("total_variation", "bending"):
            raise ValueError(f'epsilon belongs to name = "total_variation" or "bending", not to "{self.name}"')
        return self


class Stage(Table):
    """What is done otherwise from a step on, up to the next stage; what a stage leaves out is as the recipe says."""

    from_step: Whole = Field(ge=0)
    scale: Annotated[Number, Field(gt=0, le=1)] = 1.0  # of the size of the images: 0.5 for a quarter of the pixels
    spp: Count | None = None
    views_per_step: Count | None = None
    parameters: Annotated[list[str], Field(min_length=1)] | None = None  # names or globs of what moves; None: all
    learning_rates: dict[str, Positive] = {}  # by name or glob, before the schedule's factor


class Report(Table):
    spp: Count = 1024  # of the before and after images at most: they end where no noise is seen
    checkpoint_every: Count = 50
    # Standard deviations of what is recovered: "auto", where they cost less than the run; "all", also of maps within bounds.
    deviations: Literal["auto", "all", "none"] = "auto"


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
    views_per_step: Count | None = None  # of the targets, taken in turn in random order; None: all in each step
    targets: list[Target] = Field(min_length=1)
    parameters: list[Parameter] = Field(min_length=1)
    gains: Gains | None = None  # None: the images are exposed as they are rendered
    render: Render = Render()
    loss: list[AnyLoss] = Field(default_factory=lambda: [TwoBufferL2(name="two_buffer_l2")], min_length=1)
    priors: list[Prior] = []
    optimizer: AnyOptimizer = Adam()
    schedule: AnySchedule = Constant()
    stages: list[Stage] = []
    report: Report = Report()

    @property
    def groups(self) -> list[Group]:
        """All that moves."""
        return [*self.parameters, *([] if self.gains is None else [self.gains])]

    def optimizer_of(self, group: Group) -> AnyOptimizer:
        """The optimiser of a parameter or of the gains."""
        return group.optimizer or self.optimizer

    def schedule_of(self, group: Group) -> AnySchedule:
        """The schedule of a parameter or of the gains."""
        return group.schedule or self.schedule

    @model_validator(mode="after")
    def _check_learning_rates(self):
        for group in self.groups:
            schedule, rates = self.schedule_of(group), [group.learning_rate or self.optimizer_of(group).learning_rate]
            if isinstance(schedule, Step):
                rates += [rate for stage in self.stages for rate in stage.learning_rates.values()]
                times = (self.steps - 1) // schedule.every
                largest = math.log10(max(rates)) + times * math.log10(schedule.factor)
                if largest > math.log10(LARGEST):
                    raise ValueError(f"a schedule.factor of {schedule.factor:g}, {times} times, makes a learning rate of "
                                     f"1e{largest:.0f} by the last step, and the most is {LARGEST:g}; lower the factor")
        return self

    @model_validator(mode="after")
    def _check_gauss_newton(self):
        if any(isinstance(group.optimizer, GaussNewton) for group in self.groups):
            raise ValueError('"gauss-newton" moves all parameters together: make it the optimizer of the recipe, not of one '
                             "parameter")
        if not isinstance(self.optimizer, GaussNewton):
            return self
        losses = [loss.name for loss in self.loss if loss.name not in SQUARES]
        unfit = {
            f"the loss {', '.join(losses)}: it takes {' and '.join(SQUARES)}": losses,
            "an optimizer, learning_rate or schedule of a parameter": [
                group for group in self.groups if group.optimizer or group.learning_rate or group.schedule],
            "a schedule: it chooses its steps itself": not isinstance(self.schedule, Constant),
            "stages": self.stages,
            "views_per_step: each step sees all targets": self.views_per_step,
            "priors": self.priors,
            "coarse_to_fine": any(each.coarse_to_fine for each in self.parameters),
        }
        for what, is_there in unfit.items():
            if is_there:
                raise ValueError(f'optimizer = "gauss-newton" cannot be used with {what}')
        return self

    @model_validator(mode="after")
    def _check_views_and_stages(self):
        counts = [self.views_per_step, *(stage.views_per_step for stage in self.stages)]
        most = max((count for count in counts if count), default=0)
        if most > len(self.targets):
            raise ValueError(f"views_per_step = {most}, and there are {len(self.targets)} targets")
        first = [stage.from_step for stage in self.stages]
        if sorted(set(first)) != first:
            raise ValueError(f"stages must begin at ascending steps, got from_step = {', '.join(map(str, first))}")
        return self
