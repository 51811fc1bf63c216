"""The scene around the examples of a category of plugins, and what is copied to render them."""

from __future__ import annotations

from typing import Any

from docs.plugin_code import LookAt, Placed, Scale, python, runnable, xml

ROUND = {"type": "path", "max_depth": 8}
CAMERA = {"type": "perspective", "fov": 34.0, "to_world": LookAt((-0.8, -4.6, 1.5), (0, 0, -0.15)),
          "film": {"type": "hdrfilm", "width": 256, "height": 256}}
CHECKED = {"type": "checkerboard", "color0": 0.2, "color1": 0.6, "to_uv": Scale(400, 400)}
RED = {"type": "rgb", "value": [0.6, 0.12, 0.08]}
SCENE = {
    "integrator": ROUND,
    "camera": CAMERA,
    "sky": {"type": "sunsky", "sun_direction": [-0.5, -0.4, 0.6], "sun_scale": 0.0, "sky_scale": 2.0},
    "lamp": {"type": "rectangle", "to_world": LookAt((-2.5, -2, 3.5)), "emitter": {"type": "area", "radiance": 7.0}},
    "floor": {"type": "rectangle", "to_world": Placed((400, 400, 1), (0, 0, -1)),
              "bsdf": {"type": "diffuse", "reflectance": CHECKED}},
    "ball": {"type": "sphere", "bsdf": {"type": "roughplastic", "diffuse_reflectance": RED, "alpha": 0.3}},
}
LACKING = {  # what the examples of a category bring along, or what would hide them
    "bsdf": ("ball",), "texture": ("ball",), "shape": ("ball",), "emitter": ("sky", "lamp"), "sensor": ("camera",),
    "film": ("camera",), "rfilter": ("camera", "ball"), "sampler": ("camera",), "integrator": ("integrator", "sky"),
    **dict.fromkeys(("medium", "phase", "volume"), ("camera", "sky", "lamp")),
}
ASSETS = 'assets=rb.asset("patches.png").parent'
PLACE = "<!-- the example -->"


def samples(category: str) -> str:
    """The argument of `rb.render` that sets the number of samples; those of samplers are their own."""
    return "" if category == "sampler" else ", spp=64"


def surroundings(category: str) -> dict[str, Any]:
    """The objects around the examples of a category."""
    return {name: value for name, value in SCENE.items() if name not in LACKING[category]}


def python_scene(category: str) -> str:
    """The source that renders `example`."""
    described = python({"type": "scene"} | surroundings(category), "scene = rb.load_dict(")
    described = described.replace('    "type": "scene",\n', '    "type": "scene",\n    **example,\n', 1)
    return runnable(f"scene = rb.load_dict({described})\n"
                    f"images = rb.render(scene{samples(category)})  # one for each camera\n"
                    'rb.save_image("example.png", images[0])')


def xml_scene(category: str) -> str:
    """The file scene.xml into which an example is pasted."""
    lines = "\n".join(['<path value="$assets"/>', PLACE, xml(surroundings(category))]).splitlines()
    return "\n".join(['<scene version="3.0.0">', *(f"    {line}" for line in lines), "</scene>"])


def xml_render(category: str) -> str:
    """The source that renders scene.xml."""
    return runnable(f'scene = rb.load("scene.xml", {ASSETS})\nimages = rb.render(scene{samples(category)})')
