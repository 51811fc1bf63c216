"""Modules whose gradients would be lost or wrong: each is refused by the name of its texture."""

import re
import warnings
from collections.abc import Callable

import pytest
import torch
from torch import nn
from torch.utils.checkpoint import checkpoint

import torch_radbp as rb
from tests.scenes import SKY, load, rectangle, sensor
from tests.scenes.networks import Function, mlp, textured

NAME = "the texture 'poster.bsdf.reflectance': "


class Net(nn.Module):
    """A linear layer that `function` makes use of, onto (0, 1).

    Args:
        prepare: is given the module when it is made.
        function: from the module and places to values.
    """

    def __init__(self, function: Callable, prepare: Callable = lambda net: None):
        super().__init__()
        self.layer, self.function = nn.Linear(2, 3), function
        prepare(self)

    def forward(self, place):
        return self.function(self, place).sigmoid()


def having(**attributes) -> Callable:
    """Gives a module attributes, which are functions of it."""
    def prepare(net: nn.Module) -> None:
        for name, value in attributes.items():
            setattr(net, name, value(net))

    return prepare


def closed_over() -> nn.Module:
    weight = nn.Parameter(torch.ones(2, 3))
    return Net(lambda net, uv: net.layer(uv) + uv @ weight)


def compiled_function() -> nn.Module:
    return Net(lambda net, uv: net.compiled(uv),
               having(compiled=lambda net: torch.compile(lambda uv: uv @ net.layer.weight.T, backend="eager")))


def poster(module: nn.Module, of: str = "uv") -> rb.Scene:
    """A rectangle that fills the view under a sky, float32."""
    return load(torch.float32, sensor=sensor(3, (0.2, 0.1, 2)), poster=rectangle((0, 0, 0), 2.0, bsdf=textured(module, of)),
                sky=SKY)


def renderer(module: nn.Module, of: str = "uv") -> rb.Renderer:
    return rb.Renderer(poster(module, of), spp=1, max_depth=2, compile=False)


WEIGHT = "its module reaches module.layer.weight past its own attributes, by a list, a closure, a bound method"
BOTH = "its module reaches module.layer.weight and module.layer.bias past its own attributes"
NO_PARAMETER = "its module computes with a tensor of shape (3, 2) that requires a gradient and is none of its parameters"
REACHED_OTHERWISE = {
    "a list of weights": (lambda: Net(lambda net, uv: uv @ net.weights[0].T, having(weights=lambda net: [net.layer.weight])),
                          WEIGHT),
    "a dict of weights": (lambda: Net(lambda net, uv: uv @ net.weights["w"].T,
                                      having(weights=lambda net: {"w": net.layer.weight})), WEIGHT),
    "a closure": (closed_over, NO_PARAMETER.replace("(3, 2)", "(2, 3)")),
    "a bound method": (lambda: Net(lambda net, uv: net.method(uv), having(method=lambda net: net.layer.forward)), BOTH),
    "a list of layers": (lambda: Net(lambda net, uv: net.layer(uv) + net.layers[0](uv),
                                     having(layers=lambda net: [nn.Linear(2, 3)])), NO_PARAMETER),
    "a list of its own": (lambda: Net(lambda net, uv: net.layers[0](uv), having(layers=lambda net: [net.layer])), BOTH),
    "a buffer": (lambda: Net(lambda net, uv: net.layer(uv) + uv @ net.extra.T,
                             lambda net: net.register_buffer("extra", torch.ones(3, 2).requires_grad_())), NO_PARAMETER),
    "a tensor": (lambda: Net(lambda net, uv: net.layer(uv) + uv @ net.extra.T,
                             having(extra=lambda net: torch.ones(3, 2).requires_grad_())), NO_PARAMETER),
    "what another network gave": (lambda: Net(lambda net, uv: uv @ net.extra.T,
                                              having(extra=lambda net: 2 * net.layer.weight)), WEIGHT),
    "a compiled function": (compiled_function, WEIGHT),
    "a module without parameters": (lambda: Function(nn.Sequential(nn.Linear(2, 3), nn.Sigmoid()).forward),
                                    "its module computes with a tensor of shape (3"),
    "reentrant checkpoints": (lambda: Net(lambda net, uv: checkpoint(net.layer, uv, use_reentrant=True)),
                              "its module uses torch.utils.checkpoint with use_reentrant=True"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("make, message", REACHED_OTHERWISE.values(), ids=REACHED_OTHERWISE)
def test_weights_that_are_reached_otherwise(make, message):
    with pytest.raises(ValueError, match=re.escape(NAME + message)):
        renderer(make())()


@pytest.mark.hostile
@pytest.mark.parametrize("compiled", [lambda net: net, lambda net: net.layer], ids=["the module", "a layer"])
@pytest.mark.parametrize("later", [False, True], ids=["before", "later"])
def test_a_module_that_has_been_compiled(compiled, later):
    net = Net(lambda net, uv: net.layer(uv))
    if not later:
        compiled(net).compile()
    ours = renderer(net)
    if later:
        ours()
        compiled(net).compile()
    with pytest.raises(TypeError, match=re.escape(NAME) + "its module.* has been compiled by .compile()"):
        ours()


DROPPED = "Dropout, is in training mode, where values depend on chance"
BATCH = "BatchNorm1d, takes means over the places that are computed together, which change with the chunk and the bounce; "
AGAIN = "call .eval() on the module, and again after Renderer.train()"
MODES = {
    "dropout": (lambda: nn.Sequential(mlp(2, 3), nn.Dropout(0.1)), f"its module.1, {DROPPED}"),
    "dropout within": (lambda: nn.Sequential(nn.Sequential(nn.Dropout(0.1)), mlp(2, 3)), f"its module.0.0, {DROPPED}"),
    "dropout of features": (lambda: nn.Sequential(mlp(2, 3), nn.AlphaDropout()), "its module.1, AlphaDropout, is in"),
    "random slopes": (lambda: nn.Sequential(mlp(2, 3), nn.RReLU()), "its module.1, RReLU, is in training mode"),
    "batch norm": (lambda: nn.Sequential(nn.BatchNorm1d(2), mlp(2, 3)), f"its module.0, {BATCH}{AGAIN}"),
    "batch norm without statistics": (lambda: nn.Sequential(nn.BatchNorm1d(2, track_running_stats=False), mlp(2, 3)).eval(),
                                      f"its module.0, {BATCH}let it keep running statistics"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("recorded", [True, False], ids=["recorded", "not recorded"])
@pytest.mark.parametrize("make, message", MODES.values(), ids=MODES)
def test_modes_in_which_values_depend_on_chance_or_on_the_chunk(make, message, recorded):
    with torch.set_grad_enabled(recorded), pytest.raises(ValueError, match=re.escape(NAME + message)):
        renderer(make())()


BEHAVIOURS = {
    "functional dropout": (lambda: Net(lambda net, uv: nn.functional.dropout(net.layer(uv), 0.1, net.training)),
                           "its module gives other values each time that it is run"),
    "noise": (lambda: Net(lambda net, uv: net.layer(uv) + 0.1 * torch.randn_like(uv[:, :1])),
              "its module gives other values each time that it is run"),
    "softmax over rows": (lambda: Net(lambda net, uv: net.layer(uv).softmax(0)), "a row of what its module returns depends"),
    "a mean over rows": (lambda: Net(lambda net, uv: net.layer(uv) - net.layer(uv).mean(0)),
                         "a row of what its module returns depends on other rows of what it gets"),
    "a maximum over rows": (lambda: Net(lambda net, uv: net.layer(uv / uv.amax())), "a row of what its module returns"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("make, message", BEHAVIOURS.values(), ids=BEHAVIOURS)
def test_values_that_depend_on_chance_or_on_other_rows(make, message):
    with pytest.raises(ValueError, match=re.escape(NAME + message)):
        renderer(make())()


@pytest.mark.hostile
def test_training_a_renderer_puts_its_networks_into_training_mode():
    net = nn.Sequential(mlp(2, 3), nn.Dropout(0.5)).eval()
    ours = renderer(net)
    ours()
    ours.train()
    with pytest.raises(ValueError, match=re.escape(f"{NAME}its module.1, {DROPPED}")):
        ours()
    net.eval()
    ours()


@pytest.mark.hostile
@pytest.mark.parametrize("forward", [
    lambda net, uv: net.layer(uv).detach(), lambda net, uv: torch.from_numpy(net.layer(uv).detach().numpy()),
    torch.no_grad()(lambda net, uv: net.layer(uv)), lambda net, uv: 0 * uv[:, :1],
], ids=["detach", "numpy", "no_grad", "none"])
def test_parameters_that_nothing_depends_on_are_warned_of(forward):
    ours = renderer(Net(forward))
    with pytest.warns(UserWarning, match=re.escape(f"{NAME}the values of its module do not depend on its parameters")):
        ours()
    frozen = renderer(Net(forward).requires_grad_(False))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ours()  # warned of once
        frozen()


def slope_of_a_potential(net: nn.Module, uv: torch.Tensor) -> torch.Tensor:
    with torch.enable_grad():
        place = uv.detach().requires_grad_()
        return torch.autograd.grad(net.layer(place).sin().sum(), place, create_graph=True)[0][:, :1]


RIGHT = {
    "non-reentrant checkpoints": lambda: Net(lambda net, uv: checkpoint(net.layer, uv, use_reentrant=False)),
    "leaves of its own making": lambda: Net(slope_of_a_potential),
    "weight norm": lambda: Net(lambda net, uv: net.layer(uv), lambda net: nn.utils.parametrizations.weight_norm(net.layer)),
    "a module list": lambda: Net(lambda net, uv: net.layer(uv) + net.more[0](uv),
                                 having(more=lambda net: nn.ModuleList([nn.Linear(2, 3)]))),
    "dropout that drops nothing": lambda: nn.Sequential(mlp(2, 3), nn.Dropout(0.0)),
    "batch norm of running statistics": lambda: nn.Sequential(nn.BatchNorm1d(2), mlp(2, 3)).eval(),
    "softmax of channels": lambda: nn.Sequential(nn.Linear(2, 3), nn.Softmax(1)),
}


@pytest.mark.parametrize("make", RIGHT.values(), ids=RIGHT)
def test_what_has_the_gradient_of_the_tape_is_not_refused(make):
    ours = renderer(make())
    found = []
    for adjoint in (rb.TapeAdjoint(), rb.MemoizedAdjoint()):
        ours.adjoint = adjoint
        weights = [weight for weight in ours.parameters() if weight.requires_grad]
        gradients = torch.autograd.grad(ours(seed=1).square().sum(), weights)
        found.append(torch.cat([gradient.flatten() for gradient in gradients]))
    assert float(found[0].abs().max()) > 1e-3
    assert torch.allclose(*found, rtol=1e-4, atol=1e-5)  # rounding of float32


def test_a_network_is_checked_once_and_again_when_it_changes():
    net, calls = mlp(2, 3), []
    ours = renderer(net)
    ours(seed=1)
    net[0].register_forward_hook(lambda *_: calls.append(1))
    counts = []
    for step in range(4):
        if step == 2:
            net[1] = nn.Sigmoid()
        calls.clear()
        ours(seed=1)
        counts.append(len(calls))
    assert counts[0] == counts[1] == counts[3] == counts[2] - 3


def test_chance_is_not_drawn_from():
    ours = renderer(mlp(2, 3))
    torch.manual_seed(3)
    expected = torch.rand(1)
    torch.manual_seed(3)
    ours()
    assert torch.equal(torch.rand(1), expected)


def test_forward_mode_refuses_them_too():
    net = Net(lambda net, uv: uv @ net.weights[0].T, having(weights=lambda net: [net.layer.weight]))
    with pytest.raises(ValueError, match=re.escape(NAME + NO_PARAMETER)):
        rb.jvp(poster(net), {"poster.bsdf.reflectance.module.layer.weight": torch.ones(3, 2)}, spp=1, max_depth=2)


def bumpy(module: nn.Module) -> rb.Renderer:
    """A poster with heights that a module gives."""
    bsdf = {"type": "bumpmap", "nested_texture": rb.NeuralTexture(module),
            "nested_bsdf": {"type": "diffuse", "reflectance": 0.5}}
    scene = load(torch.float32, sensor=sensor(3, (0.2, 0.1, 2)), poster=rectangle((0, 0, 0), 2.0, bsdf=bsdf), sky=SKY)
    return rb.Renderer(scene, spp=1, max_depth=2, compile=False)


class Level(nn.Module):
    """The same height everywhere."""

    def __init__(self):
        super().__init__()
        self.height = nn.Parameter(torch.ones(1))

    def forward(self, place):
        return self.height.expand(len(place), 1)


HEIGHTS = "the heights that the module of the texture 'poster.bsdf.nested_texture' returns do not depend on what it gets"
SLOPES = "the slopes of the texture 'poster.bsdf.nested_texture', derivatives of its module by the place, have "
ADVICE = "keep square roots, norms, logarithms and quotients in the module away from 0"
BUMPS = {
    "a constant": (Level, HEIGHTS),
    "a number": (lambda: Function(lambda uv: torch.ones_like(uv[:, :1])), HEIGHTS),
    "detached": (lambda: Function(lambda uv: uv[:, :1].detach()), HEIGHTS),
    "in steps": (lambda: Function(lambda uv: (uv[:, :1] > 0.5).to(uv)), HEIGHTS),
    "a root of zero": (lambda: Function(lambda uv: (0 * uv[:, :1]).sqrt()), SLOPES),
    "a norm of zero": (lambda: Function(lambda uv: (0 * uv).square().sum(1, keepdim=True).sqrt()), SLOPES),
}


@pytest.mark.parametrize("recorded", [True, False], ids=["recorded", "not recorded"])
@pytest.mark.parametrize("make, message", BUMPS.values(), ids=BUMPS)
def test_heights_without_a_slope(make, message, recorded):
    with torch.set_grad_enabled(recorded), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ValueError, match=re.escape(message)):
            bumpy(make())()


MODULE = "the module of the texture 'poster.bsdf.reflectance' "
FAILED = MODULE + "has failed on places of shape (64, 2) in torch.float32, which are (N, 2) with of=\"uv\" and (N, 3) with"
LIKE_SCENE = MODULE + "must return torch.float32 on cpu, as the scene is, got "
SHAPE = MODULE + "must return shape (9, 1) or (9, 3) for places of shape (9, 2), got "
BAD = f"the texture 'poster.bsdf.reflectance' has 9 of 9 values that are NaN or infinite; {ADVICE}"
FIRST = "parameter 'poster.bsdf.reflectance.module.0.weight' is "
VALUES = {
    "too many coordinates": (lambda: nn.Linear(3, 3), RuntimeError, FAILED),
    "a coordinate that is not there": (lambda: Function(lambda uv: uv[:, 2]), RuntimeError, FAILED),
    "of another dtype": (lambda: Function(lambda uv: uv.double()[:, :1]), TypeError, LIKE_SCENE + "torch.float64 on cpu"),
    "in bfloat16": (lambda: Function(lambda uv: uv[:, :1].bfloat16()), TypeError, LIKE_SCENE + "torch.bfloat16 on cpu"),
    "of truth values": (lambda: Function(lambda uv: uv[:, :1] > 0.5), TypeError, LIKE_SCENE + "torch.bool on cpu"),
    "on no device": (lambda: Function(lambda uv: uv[:, :1].to("meta")), TypeError, LIKE_SCENE + "torch.float32 on meta"),
    "of four channels": (lambda: nn.Linear(2, 4).requires_grad_(False), ValueError, SHAPE + "(9, 4)"),
    "without channels": (lambda: Function(lambda uv: uv[:, 0]), ValueError, SHAPE + "(9,)"),
    "a tuple": (lambda: Function(lambda uv: (uv, uv)), TypeError, MODULE + "must return a tensor, got tuple"),
    "not a number": (lambda: Function(lambda uv: (uv[:, :1] - 9).log()), ValueError, BAD),
    "infinite": (lambda: Function(lambda uv: uv[:, :1] / 0), ValueError, BAD),
    "parameters in bfloat16": (lambda: mlp(2, 3).bfloat16(), TypeError, FIRST + "torch.bfloat16; a scene is rendered in"),
    "parameters on no device": (lambda: mlp(2, 3).to("meta"), ValueError, "its 0.weight is on the device meta, which holds"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("make, kind, message", VALUES.values(), ids=VALUES)
def test_what_a_module_cannot_be_or_return(make, kind, message):
    ours = renderer(mlp(2, 3))
    with pytest.raises(kind, match=re.escape(message)):
        ours.scene.poster.bsdf.reflectance = make()
        ours()


def test_a_derivative_of_a_module_that_is_not_finite():
    message = (f"in the derivative of the module of 'poster.bsdf.reflectance' by its own parameters; {ADVICE}")
    image = renderer(Net(lambda net, uv: (0 * net.layer(uv)).sqrt()))()
    with pytest.raises(rb.NonFiniteError, match=re.escape(message)) as caught:
        image.sum().backward()
    assert "`poster.bsdf.reflectance.module.layer.weight` of the diffuse" in str(caught.value)
