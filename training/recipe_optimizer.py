"""The tables of a recipe's `[optimizer]` and `[schedule]`, which parameters may have of their own, too."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from torch_radbp.training.recipe_values import Count, Fraction, Number, Positive, Switch, Table


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


class AdamUniform(Optimizer):
    """`rb.optim.AdamUniform`: one step size for all entries of a parameter; for `parametrisation = "large_steps"`."""

    name: Literal["adam_uniform"]
    betas: tuple[Fraction, Fraction] = (0.9, 0.999)
    eps: Positive = 1e-12


class GaussNewton(Table):
    """`rb.optim.GaussNewton`: least squares by derivatives in forward mode, of all parameters together."""

    learning_rate: ClassVar[float] = 1.0  # whole steps; none is chosen

    name: Literal["gauss-newton"]
    max_spp: Count | None = None  # samples per pixel where noise limits steps; None: 64 times those of `[render]`
    damping: Number = Field(1e-6, ge=0)
    robust: Positive | None = None  # size of residuals beyond which they count less; None: all count the same
    iterations: Count = 10  # of conjugate gradients, of more than 64 numbers


def _named(given: Any) -> Any:
    """An optimiser by its name alone has its defaults."""
    return {"name": given} if isinstance(given, str) else given


AnyOptimizer = Annotated[Adam | SGD | RMSprop | AdamUniform | GaussNewton, Field(discriminator="name"),
                         BeforeValidator(_named)]


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
