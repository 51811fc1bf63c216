"""Bundled recipes, run as they stand, recover what `training/README.md` says; bounds are up to three times its errors."""

import pytest
from rich.console import Console

from torch_radbp.training.commands.bundled import bundled_recipes
from torch_radbp.training.run import run

# Recipe -> parameter -> largest figures of it in the summary.
BOUNDS = {
    "caustic": {"plate.bsdf.nested_texture.data": {"rmse": 0.0012}},
    "cornell_gauss_newton": {"red.reflectance.value": {"largest_error": 0.0039}},
    "cloud": {"cloud.interior.sigma_t.data": {"rmse": 0.1}},
    "figurine_joint": {"body.vertex_positions": {"chamfer": 0.02}, "view_3.to_world": {"angle": 0.19, "distance": 0.027},
                       "body.bsdf.base_color.data": {"rmse": 0.15}, "body.bsdf.roughness.data": {"rmse": 0.15},
                       "sky.data": {"rmse": 0.25}, "gains": {"rmse": 0.02}},
    "figurine_pose": {"figurine.to_world": {"angle": 0.25, "distance": 0.007}},
    "lamp_place": {"lamp.position": {"largest_error": 0.002}},
    "lens": {"ball.bsdf.eta": {"largest_error": 0.0029}},
    "mirror_dish": {"lamp.position": {"largest_error": 0.0023}},
    "mirror_pose": {"figurine.to_world": {"angle": 1.0, "distance": 0.0035}},
    "room_camera": {"sensor.to_world": {"angle": 0.2, "distance": 0.008}},
    "smoke": {"smoke.interior.sigma_t.data": {"rmse": 0.035}},
    "smoke_around": {"smoke.interior.sigma_t.data": {"rmse": 0.03}},
    "smoke_network": {"smoke.interior.sigma_t.data": {"rmse": 0.04}},
    "three_shadows": {"body.vertex_positions": {"chamfer": 0.018}},
    "translucent_ball": {"ball.interior.albedo.value.value": {"largest_error": 0.03}},
}


@pytest.mark.deep
@pytest.mark.parametrize("name", BOUNDS)
def test_a_recipe_recovers_what_it_says(name, tmp_path):
    summary, _ = run(bundled_recipes()[name], [], tmp_path / "run", False, Console(quiet=True))
    found = {each["name"]: each | each.get("pose_error", {}) for each in summary["parameters"]}
    for parameter, bounds in BOUNDS[name].items():
        for key, most in bounds.items():
            assert found[parameter][key] < most, (parameter, key)
