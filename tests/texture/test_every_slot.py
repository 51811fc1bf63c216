"""Textures that are neither colours nor images, in the place of every texture of every material."""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import assert_informative, cotangent, relative_error, unwarned_renderer
from tests.scenes import SKY, load, rectangle, rgb, sensor, texels
from tests.scenes.every_plugin import grid
from tests.scenes.mesh_attributes import add_attributes, panel
from tests.scenes.parts import TO_UV
from tests.texture.slots import FIRST, OTHERS, SLOTS, WHITE

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
SETTINGS = {"spp": 6, "max_depth": 4, "rr_depth": 2, "compile": False}
# Values that are normals as well: above a half.
BOARD = {"type": "checkerboard", "color0": 0.55, "to_uv": TO_UV, "color1": {
    "type": "bitmap", "data": 0.5 + 0.4 * texels(2, 3), "raw": True}}
TEXTURES = {
    "checkerboard": BOARD,
    "trilinear": BOARD["color1"] | {"data": 0.5 + 0.4 * texels(9, 7), "filter_type": "trilinear", "to_uv": TO_UV},
    "of vertices": {"type": "mesh_attribute", "name": "vertex_color"},
    "of faces": {"type": "mesh_attribute", "name": "face_amount", "scale": 0.9},
    "volume": {"type": "volume", "volume": grid(3) | {"data": 0.5 + 0.4 * texels(2, 6).reshape(2, 2, 3, 3)}},
    "checkerboard of attributes": BOARD | {"color0": {"type": "mesh_attribute", "name": "vertex_color"}},
}
ALSO = OTHERS | {
    # Lobes without which some values are not read, and a colour to tint them with.
    "principled": {"base_color": rgb(0.3, 0.6, 0.2), "sheen": 0.6, "clearcoat": 0.7},
    "principledthin": {"base_color": rgb(0.3, 0.6, 0.2), "sheen": 0.6, "spec_trans": 0.5}}
PARTNERS = {"alpha_u": {"alpha_v": 0.3}, "alpha_v": {"alpha_u": 0.3}, "k": {"eta": 0.2}}
LEVEL = ("bumpmap", "of faces")  # turns no normal


def build(bsdf: dict) -> rb.Scene:
    scene = load(sensor=sensor(6, (0.3, 0.4, 2.4), (0, 0, 0), 25), subject=panel(bsdf=bsdf), sky=SKY,
                 floor=rectangle((0, -0.6, 0), 3.0, angle=-90, bsdf=WHITE),
                 lamp=rectangle((0, 0.5, 4), axis=(0, 1, 0), angle=180, emitter={"type": "area", "radiance": rgb(6, 7, 8)}))
    return add_attributes(scene)


@pytest.mark.parametrize("texture", deep_but(["checkerboard of attributes"], TEXTURES))
@pytest.mark.parametrize("kind, slot", [case if case in FIRST else deep(*case) for case in SLOTS])
def test_every_slot_gives_the_gradient_of_the_tape(kind, slot, texture):
    if (kind, texture) == LEVEL:
        texture = "of vertices"
    bsdf = {"type": kind} | ALSO.get(kind, {}) | PARTNERS.get(slot, {}) | {slot: TEXTURES[texture]}
    scene = build(bsdf)
    names = [name for name, _ in scene.named_parameters() if name.startswith((
        f"subject.bsdf.{slot}.", "subject.vertex_color", "subject.face_amount"))]
    reference, expected = gradients(scene, names, adjoint=rb.TapeAdjoint())
    image, found = gradients(scene, names)
    assert_informative(reference, [expected])
    assert relative_error(image, reference) < 1e-10
    assert relative_error(found, expected) < 1e-10


def gradients(scene: rb.Scene, names: list[str], **settings) -> tuple[torch.Tensor, torch.Tensor]:
    """An image, and the derivatives by some parameters one after the other; 0 by those that nothing reads."""
    wanted = [scene.get_parameter(name).requires_grad_() for name in names]
    image = unwarned_renderer(scene, **SETTINGS, **settings)(seed=3)
    found = torch.autograd.grad(image, wanted, cotangent(image.detach()), materialize_grads=True)
    return image.detach(), torch.cat([part.flatten() for part in found])
