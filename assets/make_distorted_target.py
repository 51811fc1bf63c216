"""Renders the image of a camera with a distorted lens, which Mitsuba does not have, by Mitsuba's integrator.

    python assets/make_distorted_target.py        # calibrated_room/target.exr; needs mitsuba==3.9.1

The rays are made here, with numpy, from OpenCV's published formulas: the Brown-Conrady distortion of `calib3d`, and its
inverse by Newton's method on numerical derivatives. Nothing of this project is used, so that a recovery is checked against a
camera that it did not make. Mitsuba loads the scene without its sensor, traces the rays, and the samples of each pixel are
averaged (a box filter).
"""

import argparse
from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi
import numpy as np

ROOM = Path(__file__).parent / "calibrated_room"
SQUARES = 8  # along a side of a pixel
SPP, PASS_SPP = 2048, SQUARES**2


def distort(point: np.ndarray, k1: float, k2: float, p1: float, p2: float) -> np.ndarray:
    """Distorted points (N, 2) of the image plane at distance 1, x to the right and y down."""
    x, y = point.T
    square = x**2 + y**2
    radial = 1 + k1 * square + k2 * square**2
    return np.stack([x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
                     y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y], 1)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Determinants of pairs of vectors (N, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def undistort(distorted: np.ndarray, *lens: float) -> np.ndarray:
    """The points (N, 2) that `distort` takes there. Raises RuntimeError where there is none."""
    point, step = distorted.copy(), 1e-5
    for _ in range(8):
        by_x, by_y = ((distort(point + step * axis, *lens) - distort(point - step * axis, *lens)) / (2 * step)
                      for axis in np.eye(2))
        off = distort(point, *lens) - distorted
        change = np.stack([cross(off, by_y), cross(by_x, off)], 1)  # Cramer's rule
        point -= change / cross(by_x, by_y)[:, None]
    off = np.abs(distort(point, *lens) - distorted).max()
    if not off < 1e-10:
        raise RuntimeError(f"the distortion is not inverted: off by {off}")
    return point


def read_sensor(sensor: ElementTree.Element) -> tuple[dict[str, float], np.ndarray, np.ndarray, int, int]:
    """Intrinsics, the camera's origin, its axes to the right, down and ahead as rows, width and height in pixels."""
    numbers = {each.get("name"): float(each.get("value")) for each in sensor.iter("float")}
    size = {each.get("name"): int(each.get("value")) for each in sensor.find("film").iter("integer")}
    look = {key: np.array([float(part) for part in text.split(",")]) for key, text in sensor.find(".//lookat").items()}
    ahead = look["target"] - look["origin"]
    right = np.cross(ahead, look["up"])
    axes = np.stack([right, np.cross(ahead, right), ahead])
    return numbers, look["origin"], axes / np.linalg.norm(axes, axis=1, keepdims=True), size["width"], size["height"]


def render(spp: int) -> np.ndarray:
    """Linear RGB, (H, W, 3)."""
    root = ElementTree.parse(ROOM / "scene.xml").getroot()
    sensor = root.find("sensor")
    lens, origin, axes, width, height = read_sensor(sensor)
    root.remove(sensor)
    for file in root.iter("string"):
        if file.get("name") == "filename":
            file.set("value", str(ROOM / file.get("value")))
    scene = mi.load_string(ElementTree.tostring(root, encoding="unicode"))
    row, column = (np.repeat(part.ravel(), PASS_SPP) for part in np.mgrid[:height, :width])
    total = np.zeros((height, width, 3))
    for seed in range(spp // PASS_SPP):
        # One sample in each of the squares into which a pixel is divided; (0, 0) is its middle.
        square = np.tile(np.mgrid[:SQUARES, :SQUARES].reshape(2, -1), height * width)
        offset = (square + np.random.default_rng(seed).uniform(0, 1, square.shape)) / SQUARES - 0.5
        x, y = column + offset[0] - lens["cx"], row + offset[1] - lens["cy"]
        distorted = np.stack([x / lens["fx"], y / lens["fy"]], 1)
        point = undistort(distorted, *(lens[name] for name in ("k1", "k2", "p1", "p2")))
        direction = np.concatenate([point, np.ones((len(point), 1))], 1) @ axes
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        ray = mi.RayDifferential3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*direction.T.astype(np.float32)))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(row))
        radiance = np.array(scene.integrator().sample(scene, sampler, ray)[0])
        total += radiance.reshape(3, height, width, PASS_SPP).mean(3).transpose(1, 2, 0)
    return total / (spp // PASS_SPP)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (llvm_ad_rgb)")
    mi.set_variant(parser.parse_args().variant)
    image = mi.Bitmap(render(SPP).astype(np.float32))
    image.convert(component_format=mi.Struct.Type.Float16).write(str(ROOM / "target.exr"))
    print(f"calibrated_room/target.exr: {image.width()} x {image.height()}, {SPP} spp")
