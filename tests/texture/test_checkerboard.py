"""Checkerboards: their values, which are those of Mitsuba, and the derivatives of their colours."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import MEMOIZED, QUADRATIC, image_and_gradients, relative_error
from tests.scenes import load, rectangle, sensor, texels
from tests.scenes.parts import TO_UV
from torch_radbp.bsdf.number import NumberOf
from torch_radbp.emitter.attributes import Scaled
from torch_radbp.interface.texture import TexturePoint
from torch_radbp.io.values.transform import scale
from torch_radbp.tensors.vec import Vec2
from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.texture.checkerboard import Checkerboard

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
PLACES = [(0.1, 0.1), (0.3, 0.1), (0.3, 0.2), (-0.1, 0.1), (0.25, 0.1), (0.5, 0.0)]
SETTINGS = {"spp": 2, "max_depth": 4, "rr_depth": 2}
TOLERANCE = 1e-10


def read(texture, uv) -> np.ndarray:
    """(N, 3) values at (N, 2) coordinates."""
    reader, dtype = texture.reader(), torch.float64
    bank = reader.bank([texture], dtype, torch.device("cpu"))
    uv = torch.as_tensor(np.asarray(uv), dtype=dtype)
    return reader.read(bank, torch.zeros(len(uv), dtype=torch.int32), TexturePoint(Vec2.of(uv), {})).stack().detach().numpy()


def test_values_and_numbers_are_those_of_mitsuba():
    """Printed by Mitsuba 3.9.1, `scalar_rgb`:

        t = mi.load_dict({"type": "checkerboard", "to_uv": mi.ScalarTransform4f().scale([2, 3, 1])})
        for si.uv in PLACES: print(t.eval(si), t.eval_1(si))
    """
    board = Checkerboard(to_uv=torch.from_numpy(scale((2, 3, 1))))
    assert read(board, PLACES)[:, 0] == pytest.approx([0.4, 0.2, 0.4, 0.2, 0.4, 0.4])
    owner = torch.nn.Module()
    owner.alpha = board
    assert read(NumberOf(owner, "alpha"), PLACES)[:, 0] == pytest.approx([0.2, 0.4, 0.2, 0.4, 0.2, 0.2])
    bright = Scaled(board, torch.tensor([1.0, 2, 3]))
    assert read(bright, PLACES[:2]).ravel() == pytest.approx([0.4, 0.8, 1.2, 0.2, 0.4, 0.6])


def test_everywhere_the_values_of_mitsuba(mi):
    colours = {"color0": {"type": "rgb", "value": [0.1, 0.5, 0.9]}, "color1": {
        "type": "bitmap", "data": texels(3, 4).astype("f4"), "raw": True}}
    theirs = mi.load_dict({"type": "checkerboard", "to_uv": mi.ScalarTransform4f(TO_UV), **colours, "color1": {
        **colours["color1"], "data": mi.TensorXf(colours["color1"]["data"])}})
    ours = Checkerboard(color0=torch.tensor([0.1, 0.5, 0.9]), color1=Bitmap(data=torch.from_numpy(texels(3, 4))),
                        to_uv=torch.from_numpy(TO_UV))
    uv = np.random.default_rng(1).uniform(-3, 3, (300, 2))
    expected = []
    for place in uv:
        si = mi.SurfaceInteraction3f()
        si.uv = place.tolist()
        expected.append(np.array(theirs.eval(si)))
    np.testing.assert_allclose(read(ours, uv), expected, atol=1e-5)


def board(factor: float = 1.0) -> dict:
    """A checkerboard of a colour and an image, of values that every place allows."""
    return {"type": "checkerboard", "color0": factor * 0.9, "to_uv": TO_UV,
            "color1": {"type": "bitmap", "data": factor * texels(2, 3), "raw": True}}


def room() -> rb.Scene:
    """Checkerboards on a floor and a ball, in a lamp and in a projector."""
    down = rb.look_at(torch.tensor([0.0, 2, 2]), torch.zeros(3)).numpy()
    return load(sensor=sensor(5, (0, 1.2, 3), (0, -0.1, 0), 45),
                floor=rectangle((0, -0.5, 0), 1.3, angle=-90, bsdf={"type": "diffuse", "reflectance": board()}),
                ball={"type": "sphere", "to_world": scale((0.4, 0.4, 0.4)), "bsdf": {
                    "type": "roughconductor", "alpha": board(factor=0.5), "material": "Au"}},
                lamp=rectangle((0, 1.5, 0.5), 0.5, angle=90, emitter={"type": "area", "radiance": board()}),
                beamer={"type": "projector", "to_world": down, "irradiance": board(), "fov": 50.0})


@pytest.mark.parametrize("sampling, compile", [("hybrid", False), ("attached", True), deep("hybrid", True),
                                               deep("attached", False)])
def test_every_strategy_gives_the_gradient_of_the_tape(sampling, compile):
    names = [name for name, _ in room().named_parameters() if ".color" in name]
    assert len(names) == 12
    settings = SETTINGS | {"sampling": sampling}
    reference, expected = image_and_gradients(room(), names, adjoint=rb.TapeAdjoint(), **settings)
    for adjoint in (MEMOIZED[0], MEMOIZED[-1], QUADRATIC[0]):
        image, gradients = image_and_gradients(room(), names, adjoint=adjoint, compile=compile, **settings)
        assert relative_error(image, reference) < TOLERANCE
        for name, gradient, wanted in zip(names, gradients, expected):
            assert wanted.abs().max() > 0, name
            assert relative_error(gradient, wanted) < TOLERANCE, name


def test_a_colour_out_of_range_is_found_and_named():
    scene = room()
    with torch.no_grad():
        scene.floor.bsdf.reflectance.color0.value.fill_(-0.2)
    with pytest.raises(ValueError, match=r"'floor.bsdf.reflectance.color0.value' must be at least 0, got -0.2"):
        rb.render(scene, spp=1)
    wall = {"type": "diffuse", "reflectance": {"type": "checkerboard", "color1": -0.3}}
    with pytest.raises(rb.SceneError, match="reflectance must be at least 0, got -0.3"):
        load(sensor=sensor(), wall=rectangle((0, 0, 0), bsdf=wall))
    neural = {"type": "diffuse", "reflectance": {"type": "checkerboard", "color1": torch.nn.Linear(2, 3)}}
    with pytest.raises(rb.SceneError, match="color1 of Checkerboard must be a colour or a bitmap, got a NeuralTexture"):
        load(sensor=sensor(), wall=rectangle((0, 0, 0), bsdf=neural))


def test_a_saved_checkerboard_looks_the_same(tmp_path):
    scene = room().float()
    rb.save(scene, tmp_path / "room.xml")
    image, expected = (rb.render(each, spp=4, max_depth=3) for each in (rb.load(tmp_path / "room.xml"), scene))
    torch.testing.assert_close(image, expected)
