"""`se3` against the matrix exponential, and its derivatives where they are delicate."""

import math

import pytest
import torch

import torch_radbp as rb
from torch_radbp.pose import sine_and_cosine_terms

AXIS = torch.tensor([0.48, -0.6, 0.64], dtype=torch.float64)
PI = math.pi
ANGLES = [0.0, 1e-12, 1e-7, 1e-3, 0.5, 1 - 1e-9, 1.0, 1 + 1e-9, 2.0, PI - 1e-7, PI, PI + 1e-3, 6.0, 2 * PI]


def exponential(w):
    x, y, z = w.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.linalg.matrix_exp(torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*w.shape, 3))


@pytest.mark.parametrize("dtype, tolerance", [(torch.float64, 2e-14), (torch.float32, 2e-6)])
def test_the_rotation_is_the_exponential(dtype, tolerance):
    generator = torch.Generator().manual_seed(0)
    random = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    w = torch.cat([AXIS * torch.tensor(ANGLES, dtype=torch.float64)[:, None], random]).to(dtype)
    matrix = rb.se3(w, torch.zeros(3, dtype=dtype))
    assert matrix.shape == (len(w), 4, 4) and matrix.dtype == dtype
    torch.testing.assert_close(matrix[:, :3, :3], exponential(w), atol=tolerance, rtol=0)
    torch.testing.assert_close(matrix[:, :3, :3] @ matrix[:, :3, :3].mT, torch.eye(3, dtype=dtype).expand(len(w), 3, 3),
                               atol=tolerance, rtol=0)


def test_the_translation_comes_after_the_rotation():
    quarter = torch.tensor([0.0, 0.0, math.pi / 2], dtype=torch.float64)
    matrix = rb.se3(quarter, torch.tensor([10.0, 20.0, 30.0], dtype=torch.float64))
    moved = matrix @ torch.tensor([1.0, 0.0, 0.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(moved, torch.tensor([10.0, 21.0, 30.0, 1.0], dtype=torch.float64))
    assert torch.equal(matrix[3], torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64))


def test_leading_axes_are_broadcast():
    matrix = rb.se3(torch.zeros(5, 1, 3), torch.arange(6.0).reshape(2, 3))
    assert matrix.shape == (5, 2, 4, 4)
    assert torch.equal(matrix[4, 1, :3, 3], torch.tensor([3.0, 4.0, 5.0]))
    assert rb.se3(torch.zeros(0, 3), torch.zeros(3)).shape == (0, 4, 4)


@pytest.mark.parametrize("angle", ANGLES)
def test_first_and_second_derivatives(angle):
    w, t = (AXIS * angle).requires_grad_(), torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(rb.se3, (w, t), atol=1e-8, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(rb.se3, (w, t), atol=1e-7)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_derivatives_at_zero_are_the_generators(dtype):
    """d exp([w]) / dw_i = [e_i]; the second derivatives are the symmetrised products of the generators."""
    zero = torch.zeros(3, dtype=dtype)
    generators = torch.zeros(3, 3, 3, dtype=dtype)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        generators[i, k, j], generators[i, j, k] = 1, -1
    first = torch.autograd.functional.jacobian(lambda w: rb.se3(w, zero)[:3, :3], zero)
    assert torch.equal(first.permute(2, 0, 1), generators)
    second = torch.func.jacfwd(torch.func.jacrev(lambda w: rb.se3(w, zero)[:3, :3]))(zero)
    products = torch.einsum("iab,jbc->ijac", generators, generators)
    torch.testing.assert_close(second.permute(2, 3, 0, 1), (products + products.transpose(0, 1)) / 2, atol=0, rtol=1e-6)


def test_the_series_continue_the_quotients():
    """No step where one takes over from the other: values and first two derivatives with respect to the squared angle."""
    for function in (lambda s: sine_and_cosine_terms(s)[0], lambda s: sine_and_cosine_terms(s)[1]):
        below, above = torch.tensor(1 - 1e-15, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)
        for derivative in (function, torch.func.grad(function), torch.func.grad(torch.func.grad(function))):
            torch.testing.assert_close(derivative(below), derivative(above), atol=2e-15, rtol=0)


BAD = [
    (TypeError, (torch.zeros(3, dtype=torch.int64), torch.zeros(3)), "rotation_vector must be a tensor of floating"),
    (TypeError, (torch.zeros(3), [0.0, 0.0, 0.0]), "translation must be .* got list"),
    (ValueError, (torch.zeros(4), torch.zeros(3)), r"rotation_vector must have shape \(..., 3\), got \(4,\)"),
    (ValueError, (torch.zeros(3), torch.zeros(())), r"translation must have shape \(..., 3\), got \(\)"),
    (TypeError, (torch.zeros(3), torch.zeros(3, dtype=torch.float64)), "one dtype"),
    (ValueError, (torch.zeros(2, 3), torch.zeros(5, 3)), "broadcast"),
]


@pytest.mark.parametrize("error, arguments, message", BAD)
def test_bad_arguments_are_refused(error, arguments, message):
    with pytest.raises(error, match=message):
        rb.se3(*arguments)
