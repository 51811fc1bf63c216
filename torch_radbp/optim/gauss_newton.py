"""`GaussNewton`: least squares by the Jacobian of residuals, in few steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.optim.linearisation import Images, Linearisation
from torch_radbp.optim.quadratic_model import Model, diagonal_of, model_of, noise_of_j, proposed, trial_of
from torch_radbp.optim.separate_columns import SeparateColumns
from torch_radbp.scene.modules.bounds import held_by, range_of
from torch_radbp.scene.modules.scene import Scene

FULL = 64  # parameters whose Jacobian is computed as a whole; for more, conjugate gradients
PROBES = 8  # of the diagonal of J^T W J, which preconditions these
KEPT = 8  # steps with one Jacobian, or diagonal, at most
FORWARD = 2  # images that take as long as one in forward mode
SHORT, DOUBLINGS = 1.5, 3  # a step after which the error falls by so many times what is predicted is doubled up to so often
ATTEMPTS = 5  # of a step, each with ten times the damping
NOISY = 0.3  # the share of noise in a step from which more samples are asked for
MOST_NOISE = 0.875  # of J along a step, that the step is lengthened for
LEAST_ERROR = 1e-3  # of J along a step, below which none counts
LEAST_DAMPING, FIRST_DAMPING = 1e-9, 1e-3  # of steps that are as good as predicted; after the first that was not


class KeptPlace(NamedTuple):
    """The parameters, seed and samples of the Jacobian that is kept, by which it can be computed again."""

    position: Tensor  # (n,) float64
    seed: int
    spp: int


class GaussNewton(torch.optim.Optimizer):
    """Minimises a sum of squared residuals by Gauss-Newton steps, with the damping of Levenberg and Marquardt.

        green = scene.get_parameter("green.reflectance.value")
        optimizer = rb.optim.GaussNewton([green], scene=scene, spp=16)
        for _ in range(5):
            optimizer.step(lambda seed, spp: renderer(seed=seed, spp=spp) - target)

    The closure takes a seed and a number of samples per pixel, renders by these, and returns residuals, a tensor or several
    of any shapes, in every call of the same pixels in the same order; the optimizer differentiates it, in forward mode and
    backwards. Other losses are other residuals: `(image - target) / (target + 0.01)` is the relative error,
    `(image + 0.01).log() - (target + 0.01).log()` that of logarithms, where noise of the image biases the result. Masks
    multiply residuals.

    Residuals and J have samples of their own: two renderings of residuals, r_1 and r_2, whose mean is r, and J of a third
    seed. So the gradient J^T r has no bias from noise, and steps end where it is 0. J^T J has one, which shortens steps, as
    damping does, in directions that few samples hardly see. Where J is computed as a whole, a step is lengthened by what its
    noise adds to the curvature along it, up to eightfold; where the error falls by half more than predicted, the step is
    doubled up to three times, as long as it falls further. Up to 64 parameters J is computed as a whole, in forward mode,
    parameters that change no channel in common by one rendering (`SeparateColumns`), and kept for up to 8 steps, as long as
    a new one would not lower the error more for each image: what a step leaves is the error of J along it. Beyond that,
    steps are found by products with it in conjugate gradients, each for a forward and a backward one, preconditioned by the
    diagonal of J^T J, of 8 backward ones, or a tenth of its mean where it is less, until what is left of the gradient is 0.2
    of its noise. A step counts if the squared error r_1^T r_2 falls, at the same seeds before and after, else damping grows.
    Where more than 0.3 of a step is noise of r, by how far apart its two renderings are, `spp` is doubled, or for twice that
    share fourfold, up to `max_spp`, and with a J that is kept the error is not looked at; at `max_spp` steps become 1, 1/2,
    1/3, ..., so that the result is the mean of what single steps would find. Where 0.3 of what a new J changes along a step
    is its noise, by the same of another seed, the samples of J are doubled.

    Its `search`: `spp` now, of r and, `spp_of_j`, of J, `damping`, `gain`, the fall of the error over the predicted one,
    `noise_share`, the length of the step's noise over that of the step, `noise_of_j`, the share of J's, `error_of_j`, the
    square of its relative error along the last step that was looked at, 1 if noise hides it, `error_when_new`, the same of
    the step after which J was new, `left_since`, the product of these since then, `jacobians`, how many were computed,
    `averaged`, how many steps were limited by noise, `evaluations`, calls of the closure. One group of parameters, one
    learning rate, 1.

    `state_dict` has all of that, but for the settings of the constructor: an optimizer made with these that gets it by
    `load_state_dict` makes the same next step. A kept Jacobian is computed again, where it was.

    Args:
        params: leaves that the closure reads; of parametrised tensors their `original`.
        scene: whose ranges parameters are kept in, by projection; None: there are none.
        spp: samples per pixel of each rendering at first.
        max_spp: at the most; None: 64 times `spp`.
        damping: at first, relative to the curvature of each parameter.
        robust: the scale of residuals beyond which they count less, by weights 1 / (1 + (r / robust)^2) that are found anew
            in each step; in units of residuals. None: all count the same.
        iterations: of conjugate gradients at most, of a step.
        seed: of the first step.

    Raises:
        ValueError: if a setting is out of its range, or there are several groups.
        TypeError: as `Linearisation`.

    Reference: Nocedal and Wright 2006, "Numerical Optimization", sections 10.3 and 7.1; Cauchy weights: Holland and Welsch
    1977, "Robust regression using iteratively reweighted least-squares".
    """

    def __init__(self, params: Iterable[Tensor], scene: Scene | None = None, *, spp: int = 16, max_spp: int | None = None,
                 damping: float = 1e-6, robust: float | None = None, iterations: int = 10, seed: int = 0):
        if spp < 1 or max_spp is not None and max_spp < spp:
            raise ValueError(f"spp must be at least 1, and max_spp at least spp, got spp={spp} and max_spp={max_spp}")
        if not damping >= 0 or robust is not None and not robust > 0 or iterations < 1:
            raise ValueError("damping must be at least 0, robust positive or None, iterations at least 1, got "
                             f"damping={damping}, robust={robust}, iterations={iterations}")
        super().__init__(params, {"lr": 1.0})
        if len(self.param_groups) > 1:
            raise ValueError(f"GaussNewton takes one group of parameters, got {len(self.param_groups)}")
        self.max_spp, self.robust, self.iterations, self.seed = max_spp or 64 * spp, robust, iterations, seed
        self.low, self.high = ranges(self, scene)
        self.search = {"spp": spp, "spp_of_j": spp, "noise_of_j": 0.0, "error_of_j": 0.0, "error_when_new": 0.0,
                       "left_since": 1.0, "damping": damping, "gain": 0.0, "noise_share": 0.0, "averaged": 0,
                       "jacobians": 0, "evaluations": 0}
        self.kept: Tensor | None = None  # J of the last step, (M, n)
        self.kept_at: KeptPlace | None = None
        self.kept_for = 0
        self.columns: SeparateColumns | None = None  # of J
        self.diagonal: Tensor | None = None  # an estimate of that of J^T W J, (n,), where J is not computed as a whole

    def state_dict(self) -> dict[str, Any]:
        """All that the next step depends on beside the parameters and the settings: numbers, lists and tensors."""
        place = None if self.kept_at is None else self.kept_at._asdict()
        return super().state_dict() | {"search": dict(self.search), "seed": self.seed, "kept_for": self.kept_for,
                                       "kept_at": place, "diagonal": self.diagonal,
                                       "columns": None if self.columns is None else self.columns._asdict()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Sets the state that `state_dict` of another optimizer has returned, to continue from it.

        Raises:
            ValueError: if it is one of another optimizer.
        """
        missing = [key for key in ("search", "seed", "kept_for", "kept_at", "diagonal", "columns") if key not in state_dict]
        if missing or state_dict["search"].keys() != self.search.keys():
            raise ValueError(f"the state is none of GaussNewton: {', '.join(missing) or 'search'} missing or of another "
                             "kind")
        super().load_state_dict({key: state_dict[key] for key in ("state", "param_groups")})
        place, columns, diagonal = (state_dict[key] for key in ("kept_at", "columns", "diagonal"))
        size = len(self.low)
        if place is not None and len(place["position"]) != size:
            raise ValueError(f"the state is of {len(place['position'])} parameters, and these are {size}")
        self.search, self.seed, self.kept_for = dict(state_dict["search"]), state_dict["seed"], state_dict["kept_for"]
        self.kept = None
        self.kept_at = None if place is None else KeptPlace(
            torch.as_tensor(place["position"], dtype=torch.float64).to(self.low.device), place["seed"], place["spp"])
        self.diagonal = None if diagonal is None else diagonal.to(self.low)
        self.columns = None if columns is None else SeparateColumns(
            columns["groups"], columns["changed"].to(self.low.device), columns["failures"])

    def step(self, closure: Images) -> float:  # type: ignore[override]
        """Makes one step.

        Args:
            closure: a function of seed and spp that returns residuals.

        Returns:
            The mean squared residual before the step, less the noise of the renderings; it may be negative.

        Raises:
            ValueError: if residuals are not finite, or no parameter changes them.
        """
        state = self.search

        def counted(seed: int, spp: int | None) -> Tensor | Sequence[Tensor]:
            state["evaluations"] += 1
            return closure(seed, spp)

        linear = Linearisation(counted, self.param_groups[0]["params"], self.columns)
        with linear.sharing():
            return self.stepped(closure, linear)

    def stepped(self, closure: Images, linear: Linearisation) -> float:
        """Makes one step, with a linearisation of the residuals that counts renderings; returns the squared error before."""
        state = self.search
        seeds = [4 * self.seed + number for number in range(4)]
        self.seed += 1
        pair = [linear.values(seed, state["spp"]) for seed in seeds[:2]]
        if not all(bool(residual.isfinite().all()) for residual in pair):
            raise ValueError("residuals must be finite, got others: mask what is not")
        weights = torch.ones_like(pair[0]) if self.robust is None else \
            1 / (1 + ((pair[0] + pair[1]) / (2 * self.robust)).square())
        if self.kept is None and self.kept_at is not None:
            self.kept = self.computed_again(closure, self.kept_at)
        known = self.kept is not None
        model = self.model(linear, pair, weights, seeds[2])
        start, spp = linear.position(), state["spp"]
        for _ in range(ATTEMPTS):
            step, share = self.proposed(model, start)
            if model.jacobian is not None and self.kept_for == 0:
                state["noise_of_j"] = noise_of_j(model, step, linear.forward(step, seeds[3], state["spp_of_j"]), weights)
            true = 1.0 if model.jacobian is None else 1 - min(state["noise_of_j"], MOST_NOISE)  # share of the curvature
            step = self.within(start + step / true) - start
            predicted = 0.0 if known and share > NOISY else model.fall(step, true)
            linear.move_to(start + step)
            state["noise_share"] = share
            if known and share > NOISY:
                break  # a step as short as noise; whether the error falls cannot be told
            trial = trial_of(model, step, pair, [linear.values(seed, spp) for seed in seeds[:2]], weights)
            state["gain"] = trial.fall / predicted if predicted > 0 else 0.0
            state["error_of_j"] = 1.0 if trial.error_of_j is None else trial.error_of_j
            if predicted > 0 and trial.fall + trial.doubt > 0.1 * predicted:
                if state["gain"] > SHORT and not state["averaged"]:
                    self.lengthen(linear, model, start, step, trial.fall, pair, weights)
                break
            linear.move_to(start)
            if known:  # no shorter step by a Jacobian of another place
                self.drop_jacobian()
                model, known = self.model(linear, pair, weights, seeds[2]), False
                continue
            state["damping"] = max(10 * state["damping"], FIRST_DAMPING)
        else:
            share = max(share, 1.0)  # a fall that so short a step does not show is one that noise hides
        if state["gain"] > 0.5:
            state["damping"] = max(0.1 * state["damping"], LEAST_DAMPING)
        if share > NOISY and state["spp"] == self.max_spp:
            state["averaged"] += 1
        elif share > NOISY:
            state["spp"] = min(state["spp"] * (4 if share > 2 * NOISY else 2), self.max_spp)
        self.judge_jacobian()
        return float((weights * pair[0] * pair[1]).sum()) / len(pair[0])

    def judge_jacobian(self) -> None:
        """Doubles the samples of J if it is noisy, and drops it where a new one pays.

        The part of the residuals that a step leaves is the error of J along it. J is kept as long as its steps lower the
        logarithm of the residuals more for each image than a new one would. The error of a new J is taken to be its noise
        plus a rest that falls with the square of the length of steps.
        """
        state = self.search
        noisy = self.kept_for == 0 and state["noise_of_j"] > NOISY and 2 * state["spp_of_j"] <= self.max_spp
        if noisy:
            state["spp_of_j"] *= 2
        if self.kept_for == 0:
            state["error_when_new"], state["left_since"] = state["error_of_j"], 1.0
        state["left_since"] *= min(state["error_of_j"], 1.0)
        self.kept_for += 1
        if noisy or self.kept_for >= KEPT or self.kept is not None and not self.pays():
            self.drop_jacobian()

    def pays(self) -> bool:
        """True if another step with the kept J costs less than one with a new one, for what it gains."""
        state = self.search
        columns = len(self.low) if self.columns is None or not self.columns.save else len(self.columns.groups) + 1
        step, jacobian = 4.0 * state["spp"], FORWARD * (columns + 1.0) * state["spp_of_j"]
        noise = min(state["noise_of_j"], state["error_when_new"])
        errors = state["error_of_j"], noise + (state["error_when_new"] - noise) * state["left_since"]
        kept, new = (-math.log(min(max(error, LEAST_ERROR), 1.0)) for error in errors)
        return errors[0] < 1 and kept / step >= new / (step + jacobian)

    def drop_jacobian(self) -> None:
        """Makes the next step compute J anew."""
        self.kept, self.kept_at = None, None

    def computed_again(self, closure: Images, place: KeptPlace) -> Tensor:
        """Computes a kept J again, (M, n), without moving the parameters or counting evaluations."""
        linear = Linearisation(closure, self.param_groups[0]["params"])
        now = linear.position()
        linear.move_to(place.position)
        try:
            return linear.jacobian(place.seed, place.spp)
        finally:
            linear.move_to(now)

    def model(self, linear: Linearisation, pair: list[Tensor], weights: Tensor, seed: int) -> Model:
        """The quadratic model around the current parameters, from two estimates of residuals, (M,) each, and J of a seed."""
        spp = self.search["spp_of_j"]
        if linear.size <= FULL:
            if self.kept is None or len(self.kept) != len(weights):
                self.kept_at, self.kept_for = KeptPlace(linear.position(), seed, spp), 0
                self.kept, self.columns = linear.jacobian(seed, spp), linear.columns
                self.search["jacobians"] += 1
                self.search["error_of_j"] = 0.0
            return model_of(self.kept, pair, weights)

        def transposed(part: Tensor) -> Tensor:
            """J^T times `part`, by the same seed as J, so that H is symmetric and has no negative eigenvalue."""
            return linear.backward(part, seed, spp)

        if self.diagonal is None or self.kept_for >= KEPT:
            self.diagonal, self.kept_for = diagonal_of(transposed, weights, PROBES, seed), 0
        gradient, noise = (transposed(weights * part) for part in ((pair[0] + pair[1]) / 2, (pair[0] - pair[1]) / 2))
        return Model(gradient, lambda step: linear.forward(step, seed, spp), weights, transposed, self.diagonal, noise)

    def proposed(self, model: Model, start: Tensor) -> tuple[Tensor, float]:
        """The step of the damped model within the ranges, (n,), and the length of its noise over its own."""
        blocked = (start <= self.low) & (model.gradient > 0) | (start >= self.high) & (model.gradient < 0)
        step, share = proposed(model, self.search["damping"], (~blocked).double(), self.iterations)
        step = step / (1 + self.search["averaged"])
        return self.within(start + step) - start, share

    def within(self, position: Tensor) -> Tensor:
        """The nearest position within the ranges, (n,)."""
        return torch.minimum(torch.maximum(position, self.low), self.high)

    def lengthen(self, linear: Linearisation, model: Model, start: Tensor, step: Tensor, fall: float, pair: list[Tensor],
                 weights: Tensor) -> None:
        """Doubles a step as long as the error falls further, where it has fallen by much more than predicted.

        J^T J overestimates curvatures by the noise of J, and by edges that move further than they are wide.
        """
        best = step
        for _ in range(DOUBLINGS):
            longer = self.within(start + 2 * best) - start
            linear.move_to(start + longer)
            after = [linear.values(4 * (self.seed - 1) + number, self.search["spp"]) for number in range(2)]
            found = trial_of(model, longer, pair, after, weights).fall
            if not found > fall:
                break
            best, fall = longer, found
        linear.move_to(start + best)


def ranges(optimizer: torch.optim.Optimizer, scene: Scene | None) -> tuple[Tensor, Tensor]:
    """The least and greatest values of an optimizer's parameters, (n,) float64 each, by the ranges of a scene.

    Raises:
        ValueError: if the optimizer holds no parameter of the scene.
    """
    held = {} if scene is None else held_by(scene, optimizer)
    if scene is not None and not held:
        raise ValueError("the optimizer holds no parameter of this scene, so that nothing would be kept in its range")
    ends = {id(each.value): range_of(each.domains, reflectances=True) for each in held.values()}
    low, high = [], []
    for parameter in optimizer.param_groups[0]["params"]:
        least, greatest = ends.get(id(parameter), (-torch.inf, torch.inf))
        low.append(torch.full((parameter.numel(),), least, dtype=torch.float64, device=parameter.device))
        high.append(torch.full((parameter.numel(),), greatest, dtype=torch.float64, device=parameter.device))
    return torch.cat(low), torch.cat(high)
