"""What is on which page of the reference and of the plugins."""

from __future__ import annotations

from typing import NamedTuple

import torch_radbp as rb


class Group(NamedTuple):
    """A page of the reference."""

    title: str
    about: str
    names: tuple[str, ...]  # as written after `rb.`; a method after its class


class Category(NamedTuple):
    """A page of plugins."""

    title: str
    about: str


GROUPS = {
    "rendering": Group("Rendering", "Images with derivatives, and derivatives as images.", (
        "Renderer", "Renderer.forward", "Renderer.radiance", "Renderer.aovs", "Renderer.memory_plan", "render", "jvp")),
    "strategies": Group("Strategies", "Where the backward pass keeps its memory; see "
                        "[the tutorial](../tutorials/11_memory.md).", (
        "MemoizedAdjoint", "ReplayAdjoint", "QuadraticAdjoint", "TapeAdjoint", "AdjointStrategy", "AdjointStrategy.kept",
        "AdjointStrategy.replayed", "AdjointStrategy.backward")),
    "scenes": Group("Scenes and files", "Reading, changing and writing scenes.", (
        "load", "load_dict", "scene_from_trimesh", "asset", "save", "save_image", "contact_sheet", "Scene", "Scene.clamp_",
        "Scene.to_trimesh", "NeuralTexture", "NeuralVolume")),
    "cameras": Group("Cameras and poses", "Poses, and cameras of other programs.", (
        "look_at", "se3", "camera_from_opencv", "cameras_from_colmap", "cameras_from_nerf", "cameras_from_kornia")),
    "losses": Group("Losses", "Losses whose gradients noise does not bias; see "
                    "[the tutorial](../tutorials/02_samples_and_losses.md).",
                    tuple(f"losses.{name}" for name in rb.losses.__all__)),
    "photographs": Group("Photographs", "Images with cameras and masks, and how a camera makes pictures of radiance.", (
        "Photographs", "Photographs.from_nerf", "Photographs.from_colmap", "Photographs.at_scale", "Photographs.batches",
        "Photographs.batch", "Photograph", "Exposure", "LensFalloff", "ToneCurve")),
    "optim": Group("Optimising", "Parametrisations, optimisers, losses of meshes; see "
                   "[the tutorial](../tutorials/06_shape.md).", tuple(f"optim.{name}" for name in rb.optim.__all__)),
    "uncertainty": Group("Uncertainty", "How far what was found can be trusted; see "
                         "[what images cannot tell](../what_images_cannot_tell.md).", (
        "covariance", "diagonal_covariance", "curvature", "next_view", "sensitivity")),
    "priors": Group("Priors", "What is likely of maps and colours.", tuple(f"priors.{name}" for name in rb.priors.__all__)),
    "bake": Group("Baking", "What was found in a form that other programs read.",
                  tuple(f"bake.{name}" for name in rb.bake.__all__)),
    "checks": Group("Checks", "Is this derivative right? See [the tutorial](../tutorials/10_checks_and_reports.md). Does a "
                    "plugin do what it says? See [another](../tutorials/09_own_material.md).", (
        "check_gradient", "GradientCheck", "GradientCheck.figures", "check_bsdf", "check_emitter", "check_texture",
        "PluginCheck")),
    "errors": Group("Errors and warnings", "What is raised and what is warned of, by class.", (
        "SceneError", "NonFiniteError", "SceneWarning", "GltfWarning", "SilhouetteWarning", "JumpWarning",
        "RepeatedNoiseWarning", "ZeroGradientWarning")),
}
PAGES = {
    "bsdf": Category("BSDFs", "How surfaces scatter light. The pictures show a ball of each on a checkered floor, under a "
                     "lamp and a clear sky. Your own: [](../tutorials/09_own_material.md)."),
    "texture": Category("Textures and spectra", "What varies over a surface, and colours. Every texture of a material can "
                        "also be a network: [](../tutorials/07_network.md)."),
    "emitter": Category("Emitters", "What sends light. The pictures show a ball under each of them alone."),
    "shape": Category("Shapes", "Surfaces. All have a pose, `to_world`, with derivatives. The squares in the pictures "
                      "follow the surface coordinates u and v, which textures are read at."),
    "sensor": Category("Sensors", "Cameras. Their poses and optics have derivatives. The pictures show the same scene."),
    "film": Category("Films", "The size of an image and how samples become pixels."),
    "rfilter": Category("Reconstruction filters", "How much a sample counts in the pixels around it. The pictures show the "
                        "edge of a glowing disk by 32 x 32 pixels."),
    "sampler": Category("Samplers", "Which random numbers the samples of a pixel get."),
    "integrator": Category("Integrators", "What of the light transport an image shows. How derivatives are computed, "
                           "`adjoint=` of {py:obj}`Renderer <torch_radbp.Renderer>` says."),
    "medium": Category("Media", "What light travels through. A medium fills the whole scene: it is that of the sensors. The "
                       "pictures show a ball in each."),
    "phase": Category("Phase functions", "The directions in which media scatter light. The pictures show a ball in fog."),
    "volume": Category("Volumes", "Values at each point of space, of which media and materials are made. "
                       "The pictures show a ball in fog."),
}


def ungrouped() -> set[str]:
    """The public names that are on no page of the reference."""
    return set(rb.__all__) - {name for group in GROUPS.values() for name in group.names}
