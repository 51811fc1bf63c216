"""A scene and a recipe of one's own, run by `radbp optimize`: python examples/own_recipe.py"""

import subprocess
import sys
from pathlib import Path

import torch

import torch_radbp as rb

steps = 100
folder = Path("runs/own_recipe")
folder.mkdir(parents=True, exist_ok=True)
camera = {"type": "perspective", "fov": 45.0, "to_world": rb.look_at([0.0, 1.5, 4.0], [0.0, 0.4, 0.0], [0.0, 1.0, 0.0]),
          "film": {"type": "hdrfilm", "width": 64, "height": 48}}
lamp = {"type": "sphere", "center": [1.5, 3.0, 1.0], "radius": 0.4, "emitter": {"type": "area", "radiance": 20.0}}
floor = torch.tensor([[4.0, 0, 0, 0], [0, 0, 4, 0], [0, -4, 0, 0], [0, 0, 0, 1]])
scene = rb.load_dict({
    "type": "scene", "camera": camera, "lamp": lamp,
    "floor": {"type": "rectangle", "to_world": floor},
    "ball": {"type": "sphere", "center": [0.0, 0.6, 0.0], "radius": 0.6, "bsdf": {
        "type": "roughconductor", "alpha": 0.15, "specular_reflectance": {"type": "rgb", "value": [0.9, 0.6, 0.2]}}}})
rb.save(scene, folder / "scene.xml")
rb.save_image(folder / "target.exr", rb.render(scene, spp=512, max_depth=4, seed=10**6)[0])
(folder / "recipe.toml").write_text(f"""\
title = "The metal of a ball"
scene = "scene.xml"
steps = {steps}
targets = [{{ image = "target.exr" }}]
parameters = [
    {{ name = "ball.bsdf.alpha.value", initial = 0.4, bounds = [0.01, 1.0], truth = "scene" }},
    {{ name = "ball.bsdf.specular_reflectance.value", initial = 0.5, bounds = [0.0, 1.0], truth = "scene" }},
]
render = {{ spp = 4, max_depth = 4 }}
loss = [{{ name = "two_buffer_l2" }}]
optimizer = {{ name = "adam", learning_rate = 0.03 }}
schedule = {{ name = "cosine" }}
""")
radbp = [sys.executable, "-m", "torch_radbp.training.cli"]  # or `radbp` on the command line
subprocess.run([*radbp, "optimize", folder / "recipe.toml", "--out", folder / "run"], check=True)
