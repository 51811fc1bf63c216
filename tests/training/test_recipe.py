"""Recipes: what is wrong is named by file, key and nearest name, before anything is written."""

from pathlib import Path

import pytest
import torch

from torch_radbp.formats.image import save_image
from torch_radbp.training.recipe_file import RecipeError, read_recipe, write_recipe
from torch_radbp.training.recovery.problem import Recovery

BAD_RECIPES = {
    "unknown key at the top": ("steps = 6", "step = 6", ["unknown key 'step'", "'steps'"]),
    "unknown key in a table": ("max_depth = 3", "max_dept = 3", ["render", "unknown key 'max_dept'", "'max_depth'"]),
    "unknown key of a parameter": ("bounds = ", "bound = ", ["parameters[0] ('paint.reflectance.value')", "'bounds'"]),
    "not TOML": ("steps = 6", "steps = = 6", ["not valid TOML", "line 2"]),
    "missing key": ("steps = 6\n", "", ["steps: this key is required"]),
    "no scene file": ('"scene.xml"', '"scenes.xml"', ["scene: no such file", "scenes.xml"]),
    "no target file": ('"target.exr"', '"photo.exr"', ["targets[0].image: no such file", "photo.exr"]),
    "steps not positive": ("steps = 6", "steps = 0", ["steps", "greater than or equal to 1", "got 0"]),
    "spp not an integer": ("spp = 4\nmax", 'spp = "many"\nmax', ["render.spp", "integer", "got 'many'"]),
    "bounds upside down": ("[0.0, 1.0]", "[1.0, 0.0]", ["parameters[0]", "lower < upper", "[1.0, 0.0]"]),
    "bounds not finite": ("[0.0, 1.0]", "[0.0, inf]", ["bounds", "finite"]),
    "initial NaN": ("initial = 0.5", "initial = nan", ["parameters[0]", "initial", "finite"]),
    "initial a boolean": ("initial = 0.5", "initial = true", ["initial", "expected a number", "True"]),
    "sigmoid without bounds": ("bounds = [0.0, 1.0]", 'parametrisation = "sigmoid"', ["sigmoid", "needs bounds"]),
    "rigid with bounds": ("initial = 0.5", 'parametrisation = "rigid"', ["rigid", "no bounds"]),
    "offset of no pose": ("initial = 0.5", "initial = { rotation = [0, 1, 0] }", ["needs parametrisation", "rigid"]),
    "unknown key of an offset": ("initial = 0.5", "initial = { rotate = [0, 1, 0] }", ["initial: unknown", "'rotation'"]),
    "offset of two axes": ("initial = 0.5", "initial = { translation = [0, 1] }", ["initial.translation", "at least 3"]),
    "network without bounds": ("bounds = [0.0, 1.0]", 'parametrisation = "network"', ["network", "needs bounds"]),
    "network with an initial value": ("initial = 0.5", 'initial = 0.5\nparametrisation = "network"', ["random weights"]),
    "network of another parametrisation": ("initial = 0.5", "network = { width = 8 }", ["needs parametrisation", "clamp"]),
    "network of no layers": (
        "initial = 0.5", 'parametrisation = "network"\nnetwork = { layers = 0 }', ["network.layers", "got 0"],
    ),
    "unknown loss": ('"two_buffer_l2"', '"l3"', ["loss[0]", "'l1'", "got 'l3'"]),
    "tone mapping of two buffers": (
        'name = "two_buffer_l2"', 'name = "two_buffer_l2"\ntone_mapping = "srgb"', ["loss[0]", "'tone_mapping'"],
    ),
    "weight not positive": ('name = "two_buffer_l2"', 'name = "l1"\nweight = -1', ["loss[0]", "weight", "got -1"]),
    "unknown optimiser": ('name = "adam"', 'name = "lbfgs"', ["optimizer", "'adam'", "got 'lbfgs'"]),
    "option of another optimiser": ('name = "adam"', 'name = "adam"\nmomentum = 0.9', ["optimizer", "'momentum'"]),
    "unknown schedule": ('name = "cosine"', 'name = "cosin"', ["schedule", "'cosine'", "got 'cosin'"]),
    "more views than targets": ("steps = 6", "steps = 6\nviews_per_step = 2", ["views_per_step = 2", "1 targets"]),
    "coarse to fine in no order": (
        "initial = 0.5\nbounds = [0.0, 1.0]", "coarse_to_fine = { cells = [2, 2], double_at = [4, 2] }",
        ["ascending", "[4, 2]"],
    ),
    "coarse to fine with bounds": (
        "initial = 0.5", "coarse_to_fine = { cells = [2, 2], double_at = [4] }", ['parametrisation = "sigmoid"'],
    ),
    "coarse to fine of a pose": (
        "initial = 0.5\nbounds = [0.0, 1.0]",
        'parametrisation = "rigid"\ncoarse_to_fine = { cells = [2, 2], double_at = [4] }', ["for maps", "rigid"],
    ),
    "unknown key of coarse to fine": (
        "bounds = [0.0, 1.0]", "coarse_to_fine = { cell = [2, 2], double_at = [4] }", ["unknown key 'cell'", "'cells'"],
    ),
    "large steps with bounds": ("initial = 0.5", 'parametrisation = "large_steps"', ["large_steps", "no bounds"]),
    "smoothness of a colour": ("initial = 0.5", "smoothness = 4", ["needs parametrisation", "large_steps", "clamp"]),
    "unknown optimiser of a parameter": (
        "initial = 0.5", 'optimizer = { name = "adm" }',
        ["parameters[0] ('paint.reflectance.value').optimizer", "'adam_uniform'"],
    ),
    "unknown prior": (
        "[render]", '[[priors]]\nname = "flat"\nparameter = "paint.*"\nweight = 1\n[render]',
        ["priors[0] ('flat').name", "'total_variation'", "'white_balance'", "got 'flat'"],
    ),
    "prior without a weight": (
        "[render]", '[[priors]]\nname = "smoothness"\nparameter = "paint.*"\n[render]', ["weight: this key is required"],
    ),
    "epsilon of another prior": (
        "[render]", '[[priors]]\nname = "smoothness"\nparameter = "paint.*"\nweight = 1\nepsilon = 0.1\n[render]',
        ["epsilon belongs to", "total_variation"],
    ),
    "stages in no order": (
        "[render]", "[[stages]]\nfrom_step = 4\n[[stages]]\nfrom_step = 2\n[render]", ["ascending steps", "4, 2"],
    ),
    "stage of larger images": ("[render]", "[[stages]]\nfrom_step = 0\nscale = 2.0\n[render]", ["stages[0].scale", "got 2"]),
    "unknown key of a stage": (
        "[render]", "[[stages]]\nfrom = 0\n[render]", ["stages[0]", "unknown key 'from'", "'from_step'"],
    ),
    "unknown key of gains": (
        "[render]", "[gains]\nwhite = true\n[render]", ["gains", "unknown key 'white'", "'white_balance'"],
    ),
    "no mask file": ('"target.exr"', '"target.exr"\nmask = "mask.png"', ["targets[0].mask: no such file"]),
    "stride without memo": (
        'caster = "brute"', 'adjoint = { strategy = "replay", stride = 2 }', ["adjoint", "stride", "memoized"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_RECIPES)
def test_bad_recipe_is_named(case, edit_recipe):
    old, new, expected = BAD_RECIPES[case]
    path = edit_recipe(old, new)
    with pytest.raises(RecipeError) as caught:
        read_recipe(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and len(message.splitlines()) == 1
    for fragment in expected:
        assert fragment in message


MISFITS = {
    "no such parameter": ("paint.reflectance.value", "pant.reflectance.value", ["'paint.reflectance.value'"]),
    "glob without a match": ("paint.reflectance.value", "*.transmittance", ["'*.transmittance'", "does not exist"]),
    "initial outside bounds": ("initial = 0.5", "initial = [0.5, 1.5, 0.5]", ["within bounds [0, 1]", "1.5"]),
    "initial of another shape": ("initial = 0.5", "initial = [0.5, 0.5]", ["initial", "shape (3,)", "(2,)"]),
    "scene value outside bounds": ("initial = 0.5\nbounds = [0.0, 1.0]", "bounds = [0.3, 1.0]", ["0.2"]),
    "truth of another shape": ('truth = "scene"', "truth = [[0.5]]", ["truth", "shape (3,)", "(1, 1)"]),
    "unknown sensor": ('image = "target.exr"', 'image = "target.exr"\nsensor = "camra"', ["'camra'", "'camera'"]),
    "parameter named twice": (
        "[render]", '[[parameters]]\nname = "paint.*"\n[render]', ["named twice", "'paint.*'"],
    ),
    "log of a value that is not positive": (
        "initial = 0.5\nbounds = [0.0, 1.0]", 'initial = 0\nparametrisation = "log"', ["log", "positive"],
    ),
    "rigid of a colour": (
        "initial = 0.5\nbounds = [0.0, 1.0]", 'parametrisation = "rigid"', ["rigid", "(4, 4)", "(3,)", "to_world"],
    ),
    "large steps of a colour": (
        "initial = 0.5\nbounds = [0.0, 1.0]", 'parametrisation = "large_steps"', ["vertex_positions", "value of a RGB"],
    ),
    "coarse to fine of a colour": (
        "initial = 0.5\nbounds = [0.0, 1.0]", "coarse_to_fine = { cells = [2, 2], double_at = [3] }", ["2 axes", "(3,)"],
    ),
    "gains of no sensor": ("[render]", '[gains]\nfixed = "camra"\n[render]', ["gains.fixed", "'camra'", "'camera'"]),
    "gains of too many": (
        "[render]", "[gains]\ninitial = [1, 2]\n[render]", ["gains.initial", "each of the 1 targets", "got 2"],
    ),
    "gains that are negative": ("[render]", "[gains]\ntruth = -1\n[render]", ["gains.truth must be positive", "-1"]),
    "prior of what is not recovered": (
        "[render]", '[[priors]]\nname = "smoothness"\nparameter = "paint.reflectanc"\nweight = 1\n[render]',
        ["priors[0].parameter", "none of the parameters that are recovered", "'paint.reflectance.value'"],
    ),
    "prior of another shape": (
        "[render]", '[[priors]]\nname = "smoothness"\nparameter = "paint.*"\nweight = 1\n[render]',
        ["the prior smoothness of 'paint.reflectance.value'", "(H, W, C)", "(3,)"],
    ),
    "stage of what is not recovered": (
        "[render]", '[[stages]]\nfrom_step = 0\nparameters = ["gains"]\n[render]', ["stages[0].parameters", "'gains'"],
    ),
    "learning rate of what is not recovered": (
        "[render]", "[[stages]]\nfrom_step = 0\nlearning_rates = { gains = 0.1 }\n[render]", ["stages[0].learning_rates"],
    ),
    "stage of pixels that are not square": (
        "[render]", "[[stages]]\nfrom_step = 0\nscale = 0.4\n[render]", ["scale = 0.4", "would not be square"],
    ),
    "no such caster": ('caster = "brute"', 'caster = "brutal"', ["brutal"]),
    "no such term": ('caster = "brute"', 'caster = "brute"\nterms = ["primry"]', ["primry", "primary", "shadow"]),
    "no such sampling": ('caster = "brute"', 'sampling = "atached"', ["atached"]),
}  # fmt: skip


@pytest.mark.parametrize("case", MISFITS)
def test_recipe_that_does_not_fit_its_scene_is_named(case, edit_recipe):
    old, new, expected = MISFITS[case]
    recipe = read_recipe(edit_recipe(old, new))
    with pytest.raises(ValueError) as caught:
        Recovery(recipe)
    for fragment in expected:
        assert fragment in str(caught.value)


def test_a_recipe_of_many_faults_is_refused_in_a_few_lines(folder):
    with (folder / "recipe.toml").open("a") as file:
        file.write("[[loss]]\n" * 50)
    with pytest.raises(RecipeError, match="and 40 more") as caught:
        read_recipe(folder / "recipe.toml")
    assert len(str(caught.value).splitlines()) == 11


def test_target_of_wrong_size_names_both_sizes(folder):
    save_image(folder / "target.exr", torch.zeros(3, 8, 6))
    with pytest.raises(ValueError, match=r"target.exr is 6 x 8 pixels, but the film of sensor 'camera' is 8 x 6"):
        Recovery(read_recipe(folder / "recipe.toml"))


def test_target_with_nan_is_refused(folder):
    # save_image refuses NaN, other programs do not.
    import numpy as np
    import OpenEXR

    pixels = np.zeros((6, 8, 3), np.float32)
    pixels[2, 3, 1] = np.nan
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": pixels}).write(str(folder / "target.exr"))
    with pytest.raises(ValueError, match=r"target.exr has 1 values that are NaN or infinite"):
        Recovery(read_recipe(folder / "recipe.toml"))


def test_missing_recipe_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such recipe: .*nothing.toml"):
        read_recipe(tmp_path / "nothing.toml")


def test_overrides_reach_tables_and_arrays(folder):
    overrides = ["steps=9", "render.spp=32", "parameters.0.bounds=[0.1, 0.9]", "optimizer.name=sgd"]
    recipe = read_recipe(folder / "recipe.toml", overrides)
    assert (recipe.steps, recipe.render.spp, recipe.optimizer.name) == (9, 32, "sgd")
    assert recipe.parameters[0].bounds == (0.1, 0.9)


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("steps", "expected key=value"),
        ("parameters.3.initial=1", "index from 0 to 0"),
        ("steps.x=1", "'steps' is a value, not a table"),
        ("render.ssp=1", "unknown key 'ssp'; did you mean 'spp'"),
    ],
)
def test_bad_override_is_named(override, expected, folder):
    with pytest.raises(RecipeError) as caught:
        read_recipe(folder / "recipe.toml", [override])
    assert expected in str(caught.value)


def test_written_recipe_reads_back_the_same_from_another_folder(folder):
    recipe = read_recipe(folder / "recipe.toml", ["parameters.0.initial=[0.1, 2e-3, 0.5]"])
    (folder / "runs" / "one").mkdir(parents=True)
    copy = folder / "runs" / "one" / "recipe.toml"
    write_recipe(recipe, copy)
    assert read_recipe(copy, allow_outside=True) == recipe
    assert str(folder) not in copy.read_text(), "paths in a written recipe are relative"


RECIPES = Path(__file__).parents[2] / "training" / "recipes"


@pytest.mark.parametrize("path", sorted(RECIPES.glob("*.toml")), ids=lambda path: path.stem)
def test_recipes_that_come_with_the_package_fit_their_scenes(path):
    recovery = Recovery(read_recipe(path, ["render.caster=brute"]))
    for parameter in recovery.parameters:
        found = parameter.compared(parameter.value)
        off = found["chamfer"] if "chamfer" in found else found["largest_error"]
        assert off > min(0.01, 0.1 * parameter.size), "a recipe does not start from the truth"  # lenses: small coefficients


def test_a_memory_budget_reaches_the_renderer_in_any_unit(folder):
    spec = ["render={caster='brute', memory_budget='1.5 GB'}"]
    renderer = Recovery(read_recipe(folder / "recipe.toml", spec)).renderer
    assert renderer.memory_budget == 1_500_000_000 and not renderer.adjoint_is_chosen
    chosen = Recovery(read_recipe(folder / "recipe.toml", [*spec, "render.adjoint.stride=2"])).renderer
    assert chosen.adjoint_is_chosen and chosen.adjoint.stride == 2
