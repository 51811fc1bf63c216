"""Derivatives of every scattering function in everything it depends on, in float64 by finite differences."""

import pytest
import torch

from tests.bsdf.lanes import DELTA, KINDS, ROUGH, SMOOTH, direction, directions, material, random_numbers, sampled, values_of
from tests.scenes.materials import MATERIALS
from torch_radbp.tensors.vec import Vec3

COUNT = 24
TURNED = [name for name in ROUGH if KINDS[name].steering]  # whose samples depend on parameters


class Setting:
    """A material on a few lanes, its values and directions as leaves."""

    def __init__(self, name: str, wi: Vec3 | None = None):
        bsdf = material(MATERIALS[name])
        self.wi = directions(COUNT, 3) if wi is None else wi
        count = len(self.wi.z)
        self.kind, self.random = bsdf.kind(), random_numbers(count)
        if not self.kind.transmits:
            self.wi = self.wi._replace(z=self.wi.z.abs())
        values = values_of(bsdf, self.wi.z)
        self.choice, wo = sampled(self.kind, values, self.wi, self.random)
        # Half of the directions at random, half sampled, where sharp lobes are.
        other, first = directions(count, 4), (torch.arange(count) % 2 == 0) & (wo.z != 0)
        self.wo = Vec3(*(torch.where(first, a, b).detach() for a, b in zip(wo, other)))
        self.sampled_wo = wo.detach()
        self.values = values

    def leaves(self, *vectors: Vec3) -> list[torch.Tensor]:
        flat = [c.detach().clone().requires_grad_() for value in self.values for c in value]
        return flat + [c.detach().clone().requires_grad_() for vector in vectors for c in vector]

    def unpack(self, leaves) -> tuple:
        vectors = [Vec3(*leaves[i:i + 3]) for i in range(0, len(leaves), 3)]
        return tuple(vectors[:len(self.values)]), *vectors[len(self.values):]

    def check(self, function, *vectors: Vec3) -> None:
        """Lane by lane derivatives: the lanes are independent, so that the sum over all of them has those of each."""
        leaves = self.leaves(*vectors)

        def outputs(*tensors):
            result = function(*self.unpack(tensors))
            return torch.stack([*result] if isinstance(result, Vec3) else [result])

        reference = outputs(*leaves)
        assert torch.isfinite(reference).all() and reference.abs().max() > 0
        if not reference.requires_grad:  # a density that is the same for all directions
            assert torch.equal(outputs(*[leaf + 1e-6 for leaf in leaves]), reference)
            return
        # Normalised lane by lane: a sharp lobe must not hide the others, nor lift them above the tolerance.
        scale = 1 / reference.detach().abs().clamp_min(1e-3)
        of_columns = [torch.autograd.grad(column.sum(), leaves, retain_graph=True, materialize_grads=True)
                      for column in reference * scale]
        steps = 1e-7 * torch.eye(len(leaves), dtype=torch.float64)[:, :, None]  # a row for each leaf that moves
        with torch.no_grad():
            up, down = (outputs(*(leaf + sign * step for leaf, step in zip(leaves, steps))) for sign in (1, -1))
        for slopes, difference in zip(of_columns, (up - down) / 2e-7 * scale[:, None]):
            torch.testing.assert_close(torch.stack(slopes), difference, atol=2e-5, rtol=2e-5)


@pytest.mark.parametrize("name", SMOOTH)
def test_eval_and_pdf(name):
    setting = Setting(name)
    setting.check(setting.kind.eval, setting.wi, setting.wo)
    if name != "diffuse":
        setting.check(setting.kind.pdf, setting.wi, setting.wo)
    else:
        setting.check(lambda values, wo: setting.kind.pdf(values, setting.wi, wo), setting.wo)


@pytest.mark.parametrize("name", dict.fromkeys([*TURNED, *DELTA]))
def test_sampled_directions(name):
    setting = Setting(name)
    setting.check(lambda values, wi: setting.kind.sample(values, wi, setting.choice, setting.random.u, setting.random.v),
                  setting.wi)


@pytest.mark.parametrize("name", TURNED)
def test_sampled_directions_at_normal_and_grazing_incidence(name):
    """At normal incidence the azimuth is not defined, but the map from wi to wo is smooth."""
    normal, nearly, grazing = (direction(z, 0.3, COUNT) for z in (1.0, 1 - 1e-12, 0.01))
    setting = Setting(name, Vec3(*map(torch.cat, zip(normal, nearly, grazing))))
    setting.check(lambda values, wi: setting.kind.sample(values, wi, setting.choice, setting.random.u, setting.random.v),
                  setting.wi)


@pytest.mark.parametrize("name", [name for name in DELTA if name != "null"])
def test_specular_weights(name):
    setting = Setting(name)
    setting.check(lambda values, wi: setting.kind.specular(values, wi, setting.choice), setting.wi)


@pytest.mark.parametrize("name", MATERIALS)
def test_forward_mode_is_the_transpose_of_reverse_mode(name):
    setting = Setting(name)
    kind, random, generator = setting.kind, setting.random, torch.Generator().manual_seed(5)

    def everything(*leaves):
        values, wi = setting.unpack(leaves)
        wo = kind.sample(values, wi, setting.choice, random.u, random.v)
        mirror = kind.specular(values, wi, setting.choice) if kind.delta else ()
        densities = (kind.eval_pdf(values, wi, wo, fixed_lobes)[1] for fixed_lobes in (False, True))
        return torch.stack([*wo, *mirror, *kind.eval(values, wi, wo), *densities])

    leaves = tuple(leaf.detach() for leaf in setting.leaves(setting.wi))
    tangents = tuple(torch.randn(COUNT, generator=generator, dtype=torch.float64) for _ in leaves)
    output, forwards = torch.func.jvp(everything, leaves, tangents)
    cotangent = torch.randn(output.shape, generator=generator, dtype=torch.float64) / (1 + forwards.abs())
    adjoints = torch.func.vjp(everything, *leaves)[1](cotangent)
    expected = sum((t * a).sum() for t, a in zip(tangents, adjoints))
    assert expected.abs() > 0
    torch.testing.assert_close((cotangent * forwards).sum(), expected, rtol=1e-9, atol=1e-9)
