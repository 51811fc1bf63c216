"""A user's script with every public name, and the types that a checker must see; `test_types.py` has it read by mypy."""

from pathlib import Path
from typing import assert_type

import torch
from torch import Tensor

import torch_radbp as rb
from torch_radbp.sensor.calibrated import Calibrated
from torch_radbp.shape.mesh import TensorMesh
from torch_radbp.texture.bitmap import Bitmap

# Scenes in and out.
scene = rb.load("scene.xml", resolution=64)
assert_type(scene, rb.Scene)
assert_type(rb.load("asset.glb", allow_outside=True), rb.Scene)
assert_type(rb.load_dict({"type": "scene"}, base_dir="."), rb.Scene)
assert_type(rb.asset("cornell_box/scene.xml"), Path)
rb.save(scene, "found.glb", strict=True)
rb.save_image("image.png", torch.zeros(3, 8, 8), curve="linear", white=2.0)
assert_type(rb.scene_from_trimesh(scene.to_trimesh(), light=0.5, spp=4), rb.Scene)
assert_type(rb.contact_sheet({"target": torch.zeros(2, 3, 8, 8)}, views=["left", "right"]), Tensor)
parameter = scene.get_parameter("green.reflectance.value").requires_grad_()
assert_type(parameter, Tensor)
scene.green.reflectance = rb.NeuralTexture(torch.nn.Linear(2, 3), of="uv")
assert_type(rb.NeuralVolume(torch.nn.Linear(3, 1), resolution=32), rb.NeuralVolume)
assert_type(rb.bake.mesh(scene.body, unwrap=True), TensorMesh)
assert_type(rb.bake.bitmap(scene.green.reflectance, (256, 512), shape=scene.body), Bitmap)

# Poses and cameras.
assert_type(rb.look_at([0, 1, 4], (0.0, 0.0, 0.0), torch.tensor([0.0, 1.0, 0.0])), Tensor)
assert_type(rb.se3(torch.zeros(3), torch.zeros(3)), Tensor)
assert_type(rb.cameras_from_colmap("sparse/0", scale=0.25), dict[str, Calibrated])
assert_type(rb.cameras_from_nerf("transforms.json", width=64), dict[str, Calibrated])
assert_type(rb.cameras_from_kornia(None), list[Calibrated])
assert_type(rb.camera_from_opencv(torch.eye(3), torch.eye(3), torch.zeros(3), 640, 480, [0.1, 0.0]), Calibrated)

# Renderings, and their derivatives.
strategies: list[rb.AdjointStrategy] = [rb.MemoizedAdjoint(stride=4), rb.MemoizedAdjoint(stride="sqrt"), rb.ReplayAdjoint(),
                                        rb.QuadraticAdjoint(), rb.TapeAdjoint()]
renderer = rb.Renderer(scene, spp=16, max_depth=6, adjoint=strategies[0], terms=["interior"], memory_budget="2GiB")
assert_type(renderer(seed=1), Tensor)
assert_type(renderer(seed=1, sensors=["front", 2], aovs=["depth"]), tuple[Tensor, dict[str, Tensor]])
assert_type(renderer.aovs(["albedo"], seed=3), dict[str, Tensor])
assert_type(renderer.spp, int)
assert_type(rb.render(scene, spp=16, seed=1), Tensor)
assert_type(rb.render(scene, seed=1, aovs=["depth"]), tuple[Tensor, dict[str, Tensor]])
assert_type(rb.jvp(scene, {"green.reflectance.value": torch.ones(3)}, spp=4), Tensor)
check = rb.check_gradient(scene, "green.reflectance.value", spp=64)
assert_type(check, rb.GradientCheck)
assert_type(check.agrees, bool)
of_plugin = rb.check_bsdf({"type": "diffuse"}, samples=10_000)
assert_type(of_plugin, rb.PluginCheck)
assert_type(of_plugin.failed, tuple[str, ...])
assert_type(rb.check_emitter({"type": "constant"}, samples=10_000), rb.PluginCheck)
assert_type(rb.check_texture({"type": "rgb", "value": 0.5}, low=0.0, high=1.0), rb.PluginCheck)

# What a loop is made of.
image, target = renderer(seed=2), renderer(seed=3).detach()
assert_type(rb.losses.two_buffer_l2(image, renderer(seed=4), target), Tensor)
assert_type(rb.losses.exchange_derivatives(image, renderer(seed=4)), tuple[Tensor, Tensor])
buffers = image, renderer(seed=4)
assert_type(rb.losses.two_buffer_relative_l2(*buffers, target), Tensor)
assert_type(rb.losses.two_buffer_log_l2(*buffers, target, mask=None), Tensor)
assert_type(rb.losses.ssim(*buffers, target), Tensor)
assert_type(rb.losses.lpips(*buffers, target, torch.nn.functional.mse_loss), Tensor)
assert_type(rb.losses.exchanged(torch.nn.functional.l1_loss, *buffers, target), Tensor)
assert_type(rb.losses.masked_mean(image, image[:, :1]), Tensor)
assert_type(rb.priors.total_variation(parameter) + rb.priors.smoothness(parameter), Tensor)
assert_type(rb.priors.bending(parameter), Tensor)
assert_type(rb.priors.white_balance(parameter), Tensor)
ranges: list[torch.nn.Module] = [rb.optim.Log(), rb.optim.Sigmoid(0.0, 1.0), rb.optim.CoarseToFine((4, 4))]
assert_type(rb.optim.bounded(torch.optim.Adam([parameter]), scene), torch.optim.Adam)
assert_type(scene.clamp_(["green.reflectance.value"]), rb.Scene)
assert_type(rb.optim.refine(scene.green, "reflectance"), bool)

# Photographs.
photographs = rb.Photographs.from_nerf("transforms.json")
assert_type(photographs, rb.Photographs)
assert_type(photographs[0], rb.Photograph)
assert_type(photographs.batch().image, Tensor)
of_camera: list[torch.nn.Module] = [rb.Exposure(3, fixed=0), rb.LensFalloff(), rb.ToneCurve()]

# Shapes.
faces, vertices = torch.zeros(1, 3, dtype=torch.int64), torch.zeros(3, 3)
steps = rb.optim.LargeSteps(faces, vertices, smoothness=19.0)
optimizer = rb.optim.AdamUniform([parameter, *steps.parameters()], lr=0.03, betas=(0.9, 0.99))
loss = image.square().mean() + rb.optim.laplacian_loss(vertices, faces) + rb.optim.normal_consistency_loss(vertices, faces)
assert_type(loss, Tensor)
optimizer.zero_grad()
optimizer.step()
rb.optim.remesh(scene.bunny, lambda v, f: (v, f), optimizer)
rb.optim.remesh(scene.bunny, scene.bunny.to_trimesh().subdivide(), optimizer)

# How far it can be trusted.
found = rb.covariance(renderer, image, ["green.reflectance.value"], noise=0.02, prior={"green.reflectance.value": 0.3})
assert_type(found.standard_deviations, dict[str, Tensor])
assert_type(found.propagated(lambda: parameter.square()), Tensor)
assert_type(rb.curvature(lambda seed, spp: renderer(seed=seed, spp=spp), {"green": parameter}).dense().matrix, Tensor)
assert_type(rb.curvature(renderer, "green.reflectance.value").product(torch.ones(3)).error, Tensor)
assert_type(rb.diagonal_covariance(renderer, ["sky.data"], noise=0.1, prior={"sky.data": 1.0}).error, dict[str, Tensor])
assert_type(rb.next_view(renderer, ["left", 1], ["sky.data"], noise=0.1, prior={"sky.data": 1.0}).best, str)
assert_type(rb.sensitivity(renderer, "green.reflectance.value"), dict[str, Tensor])
assert_type(rb.optim.GaussNewton([parameter], scene, spp=16).step(lambda seed, spp: renderer(seed=seed, spp=spp)), float)

# What may be caught, or silenced.
errors: tuple[type[Exception], ...] = (rb.SceneError, rb.NonFiniteError)
warned: tuple[type[Warning], ...] = (rb.GltfWarning, rb.JumpWarning, rb.RepeatedNoiseWarning, rb.SceneWarning,
                                     rb.SilhouetteWarning, rb.ZeroGradientWarning)
