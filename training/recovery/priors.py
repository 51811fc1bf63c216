"""What a recipe holds likely of parameters: `[[priors]]`, functions of `rb.priors` with their weights."""

from collections.abc import Callable

from torch import Tensor

from torch_radbp import priors
from torch_radbp.training import recipe
from torch_radbp.training.recovery.parameters import matching
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.training.recovery.variables import wraps

EPSILON = 1e-3  # of total variation and bending, if the recipe does not say


class Priors:
    """The sum of all priors: `priors() -> (loss, terms)`.

    Args:
        specs: the recipe's `[[priors]]` tables.
        parameters: that are recovered.

    Raises:
        ValueError: no such parameter, or one of a shape or value of which the prior says nothing.
    """

    def __init__(self, specs: list[recipe.Prior], parameters: list[RecoveredParameter]):
        self.chosen = [(spec, each) for number, spec in enumerate(specs)
                       for each in matching(parameters, spec.parameter, f"priors[{number}].parameter")]
        for spec, parameter in self.chosen:
            try:
                function_of(spec, parameter)(parameter.value)
            except ValueError as error:
                raise ValueError(f"the prior {spec.name} of {parameter.name!r}: {error}") from None

    @property
    def names(self) -> list[str]:
        """Of the terms."""
        return list(dict.fromkeys(spec.name for spec, _ in self.chosen))

    def __call__(self) -> tuple[Tensor | float, dict[str, Tensor]]:
        """Computes the weighted sum, attached, and each unweighted term by name."""
        total, terms = 0.0, {}
        for spec, parameter in self.chosen:
            term = function_of(spec, parameter)(parameter.attached)
            total = total + spec.weight * term
            terms[spec.name] = terms.get(spec.name, 0.0) + term.detach()
        return total, terms


def function_of(spec: recipe.Prior, parameter: RecoveredParameter) -> Callable[[Tensor], Tensor]:
    """What a prior computes of a parameter's values; maps that repeat have neighbours across their borders."""
    rows, columns = wraps(parameter.module)
    match spec.name:
        case "total_variation":
            return lambda values: priors.total_variation(values, spec.epsilon or EPSILON, rows, columns)
        case "bending":
            return lambda values: priors.bending(values, spec.epsilon or EPSILON)
        case "smoothness":
            return lambda values: priors.smoothness(values, rows, columns)
        case "white_balance":
            return priors.white_balance
    raise TypeError(f"no prior for {spec!r}")
