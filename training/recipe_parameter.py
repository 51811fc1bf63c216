"""The tables of a recipe's `[[parameters]]` and `[gains]`: what is recovered, from where, and by which variables."""

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from torch_radbp.training.recipe_optimizer import AnyOptimizer, AnySchedule
from torch_radbp.training.recipe_values import Count, Number, Positive, Switch, Table, Value, Whole

MOST_WEIGHTS = 1 << 24  # of a network; gradients and moments are as many each
WIDEST = 1 << 12  # waves of a network, or width: each place where it is read has so many values

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
    """A network from surface coordinates, or from places in a grid, to its values; see `recovery.network`."""

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


class CoarseToFine(Table):
    """A map whose texels move together at first, by a grid that becomes finer: see `rb.optim.CoarseToFine`."""

    cells: Annotated[list[Count], Field(min_length=2, max_length=3)]  # rows and columns of the first grid
    double_at: Annotated[list[Count], Field(min_length=1)]  # rows and columns double after so many steps

    @model_validator(mode="after")
    def _check_order(self):
        if sorted(set(self.double_at)) != self.double_at:
            raise ValueError(f"double_at must list steps in ascending order, got {self.double_at}")
        return self

    def doublings(self, step: int) -> int:
        """How often the grid has doubled after so many steps."""
        return sum(at <= step for at in self.double_at)


class Group(Table):
    """What says how fast something moves; what is left out is as the recipe's own `[optimizer]` and `[schedule]` say."""

    learning_rate: Positive | None = None  # None: the optimiser's
    optimizer: AnyOptimizer | None = None
    schedule: AnySchedule | None = None


class Gains(Group):
    """Unknown exposures: each image is the rendering times the gain of its view; see `rb.Exposure`."""

    fixed: str | None = None  # the sensor whose gain is known; None: none is
    white_balance: Switch = False  # True: red, green and blue have gains of their own
    initial: Number | list[Number] = 1.0  # one for all views, or one for each target
    truth: Number | list[Number] | None = None  # likewise; for reports only


class Parameter(Group):
    """Parameters to recover: a name as `radbp info` prints it, or a glob such as `*.reflectance.value`."""

    name: str
    initial: Initial | None = None  # None: the value in the scene file
    bounds: tuple[Number, Number] | None = None
    # How the bounds are kept: projected back after every step, or never left because a sigmoid (log) of the
    # parameter is what the optimiser sees. "rigid" is for (4, 4) matrices, which have no bounds: the optimiser sees a
    # rotation vector (radians) and a translation, see `rigid`. "network" is for bitmaps and grids: a network takes the
    # place of one, within the bounds by a sigmoid, and the optimiser sees its weights. "large_steps" is for the
    # vertex_positions of meshes: steps move the shape as a whole, see `rb.optim.LargeSteps`.
    parametrisation: Literal["clamp", "sigmoid", "log", "rigid", "network", "large_steps"] = "clamp"
    network: Network | None = None  # None: of the default size
    # Of "rigid": the place in the world that rotations are about, see `rigid`; None: the own origin.
    pivot: Vector | None = None
    smoothness: Positive | None = None  # of large steps: how far, in squared edges, one reaches; None: 19
    coarse_to_fine: CoarseToFine | None = None  # None: all texels are free from the first step on
    # For reports only. "scene": the value in the scene file; of vertex_positions also a mesh, .ply or .obj,
    # that stands where the shape's own file does.
    truth: Literal["scene"] | Value | None = None

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
        if self.parametrisation == "large_steps" and self.bounds is not None:
            raise ValueError('parametrisation = "large_steps" moves vertices together and takes no bounds')
        if self.pivot is not None and self.parametrisation != "rigid":
            raise ValueError(f'pivot = ... needs parametrisation = "rigid", got "{self.parametrisation}"')
        if self.smoothness is not None and self.parametrisation != "large_steps":
            raise ValueError(f'smoothness = ... needs parametrisation = "large_steps", got "{self.parametrisation}"')
        if self.coarse_to_fine is not None and self.parametrisation not in ("clamp", "sigmoid", "log"):
            raise ValueError(f'coarse_to_fine = ... is for maps, not for parametrisation = "{self.parametrisation}"')
        if self.coarse_to_fine is not None and self.parametrisation == "clamp" and self.bounds is not None:
            raise ValueError('coarse_to_fine = ... keeps bounds by parametrisation = "sigmoid": add that, or take the '
                             "bounds away")
        if isinstance(self.initial, Offset) and self.parametrisation != "rigid":
            raise ValueError('initial = { rotation = ..., translation = ... } needs parametrisation = "rigid"')
        return self
