"""Priors: recipes weigh functions of `rb.priors` of the parameters that they name."""

import pytest
import torch

import torch_radbp as rb
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.optimize import take_gradient
from torch_radbp.training.recovery.problem import Recovery

TEXELS = "picture.reflectance.data"
PRIORS = {
    "total_variation": ("epsilon = 0.01", lambda value: rb.priors.total_variation(value, 0.01, True, True)),
    "smoothness": ("", lambda value: rb.priors.smoothness(value, True, True)),
    "white_balance": ("", rb.priors.white_balance),
}


@pytest.mark.parametrize("name", PRIORS)
def test_a_prior_adds_its_value_and_derivative(name, folder, edit_recipe):
    """The picture repeats, so that its borders are beside each other."""
    option, prior = PRIORS[name]
    edit_recipe('name = "paint.reflectance.value"\ninitial = 0.5', f'name = "{TEXELS}"')
    plain = Recovery(read_recipe(folder / "recipe.toml"))
    edit_recipe("[render]", f'[[priors]]\nname = "{name}"\nparameter = "{TEXELS}"\nweight = 3.0\n{option}\n[render]')
    recovery = Recovery(read_recipe(folder / "recipe.toml"))
    (loss, terms, *_), (without, *_) = take_gradient(recovery, 0), take_gradient(plain, 0)
    value = plain.parameters[0].value.requires_grad_()
    expected = prior(value)
    assert expected > 1e-3
    torch.testing.assert_close(terms[name], expected.detach())
    torch.testing.assert_close(loss - without, 3.0 * expected, rtol=1e-4, atol=1e-5)
    by_prior, = torch.autograd.grad(expected, value)
    assert by_prior.abs().max() > 1e-4
    torch.testing.assert_close(recovery.parameters[0].raw.grad - plain.parameters[0].raw.grad, 3.0 * by_prior, rtol=1e-3,
                               atol=1e-5)


def test_a_prior_of_the_gains(two_views):
    with two_views.open("a") as file:
        file.write('[gains]\nwhite_balance = true\n[[priors]]\nname = "white_balance"\nparameter = "gains"\nweight = 1.0\n')
    recovery = Recovery(read_recipe(two_views))
    with torch.no_grad():
        recovery.exposure.log_balance[:, 0] += 0.3
    total, terms = recovery.priors()
    torch.testing.assert_close(terms["white_balance"], rb.priors.white_balance(recovery.exposure.gains).detach())
    assert total > 1e-3
