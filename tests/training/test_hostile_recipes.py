"""Recipes of the wrong kind, size or type: one message that names file or parameter, before anything is written."""

import pytest

from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.problem import Recovery

pytestmark = pytest.mark.hostile

# Override -> fragments of the message.
OVERRIDES = {
    "steps=true": ["steps: must be a valid integer, got True"],
    "steps=6.0": ["steps: must be a valid integer, got 6.0"],
    "steps='6'": ["steps: must be a valid integer, got '6'"],
    "steps=-1": ["steps: must be greater than or equal to 1, got -1"],
    "steps=1e12": ["steps: must be a valid integer"],
    "steps=99999999999": ["steps: must be less than 2147483648"],
    "steps=[6": ["steps: must be a valid integer, got '[6'"],
    "steps.a.b=3": ["-D 'steps.a.b=3': 'steps' is a value"],
    "=3": ["-D '=3': expected key=value"],
    "a..b=3": ["unknown key 'a'"],
    "parameters.x=3": ["-D 'parameters.x=3': expected an index from 0 to 0"],
    "parameters.-1.name='a'": ["expected an index from 0 to 0, got '-1'"],
    "render=3": ["render: expected a table, got 3"],
    "render.spp=true": ["render.spp: must be a valid integer, got True"],
    "render.compile='yes'": ["render.compile: must be a valid boolean, got 'yes'"],
    "render.compile=1": ["render.compile: must be a valid boolean, got 1"],
    "render.chunk=0": ["render.chunk", "greater than or equal to 1"],
    "render.seed=-1": ["render.seed", "greater than or equal to 0"],
    "render.seed=1.5": ["render.seed: must be a valid integer, got 1.5"],
    "render.max_depth=-2": ["render.max_depth", "-2"],
    "render.max_depth=2.5": ["render.max_depth: must be a valid integer"],
    "render.sampling=3": ["render.sampling: must be a valid string"],
    "render.memory_budget='2XB'": ["render.memory_budget", "'2GB'", "'2XB'"],
    "render.memory_budget=true": ["render.memory_budget", "True"],
    "render.memory_budget='1kB'": ["too small", "needs"],
    "render.adjoint=3": ["render.adjoint: expected a table"],
    "render.adjoint.stride='cube'": ["render.adjoint.stride", "'sqrt' or 'log'", "'cube'"],
    "optimizer.learning_rate=nan": ["optimizer.learning_rate: must be a finite number"],
    "optimizer.learning_rate='0.1'": ["optimizer.learning_rate: must be a valid number, got '0.1'"],
    "optimizer.betas=[2.0, 0.9]": ["optimizer.betas[0]: must be less than 1, got 2.0"],
    "optimizer.betas=[0.9]": ["optimizer.betas[1]"],
    "optimizer={name='sgd', nesterov=true}": ["optimizer", "nesterov = true needs a momentum"],
    "schedule={name='step', every=0}": ["schedule.every", "got 0"],
    "schedule={name='step', every=1, factor=1e300}": ["schedule.factor: must be from -1e+30 to 1e+30, got 1e+300"],
    "schedule={name='step', every=1, factor=1e8}": ["factor of 1e+08, 5 times, makes a learning rate of 1e39", "1e+30"],
    "optimizer.learning_rate=1e300": ["optimizer.learning_rate: must be from -1e+30 to 1e+30"],
    "optimizer.eps=1e300": ["optimizer.eps: must be from -1e+30 to 1e+30"],
    "loss=[{name='l1', weight=1e200}]": ["loss[0] ('l1').weight: must be from -1e+30 to 1e+30"],
    "parameters.0.bounds=[-1e300, 1.0]": ["bounds[0]: must be from -1e+30 to 1e+30, got -1e+300"],
    "schedule={name='cosine', final=2}": ["schedule.final", "got 2"],
    "loss=[]": ["loss: List should have at least 1 item"],
    "loss={name='l1'}": ["loss: must be a valid list"],
    "loss=[{name='ssim', window=13}]": ["loss: ssim cannot be computed on targets of 8 x 6 pixels", "window"],
    "loss=[{name='ms_ssim', alpha=2}]": ["loss[0] ('ms_ssim').alpha", "got 2"],
    "loss=[{name='l1', weight=inf}]": ["loss[0] ('l1').weight: must be a finite number"],
    "targets=[3]": ["targets[0]: expected a table, got 3"],
    "targets=[{image='junk.exr'}]": ["junk.exr: cannot be read as EXR"],
    "targets=[{image='folder'}]": ["targets[0].image: ", "folder: is a folder, not a file"],
    "targets=[{image='scene.xml'}]": ["scene.xml: unknown kind of image"],
    "targets=[{image='target.exr'}, {image='target.exr'}]": ["sensor 'camera' has 2 targets"],
    "targets=[{image=3}]": ["targets[0].image: must be the path of a file, got 3"],
    "scene='folder'": ["scene: ", "folder: is a folder, not a file"],
    "scene='recipe.toml'": ["recipe.toml: unknown kind of scene '.toml'"],
    "variables={width=[1]}": ["variables.width"],
    "variables={width=true}": ["variables.width", "True"],
    "variables={width='abc'}": ["width", "must be an integer, got 'abc'"],
    "variables={nope=3}": ["'nope'", "width"],
    "title=3": ["title: must be a valid string, got 3"],
    "report.spp=0": ["report.spp", "got 0"],
    "parameters.0.network={waves=12987871, width=63}": ["waves = 12987871 and width = 63: at most 4096 each"],
    "parameters.0.network={waves=65536}": ["at most 4096 each are taken, since every place has so many values"],
    "parameters.0.network={waves=4096, width=4096}": ["make 50331648 weights; at most 16777216", "fewer waves"],
    "parameters.0.name=''": ["parameter '' does not exist"],
    "parameters.0.name=3": ["parameters[0].name: must be a valid string"],
    "parameters.0.name='wall.to_world'": ["'wall.to_world'", "last row must be 0 0 0 1"],
    "parameters.0.bounds=[0, 1, 2]": ["bounds", "at most 2"],
    "parameters.0.bounds=[true, 1]": ["bounds[0]: must be a valid number, got True"],
    "parameters.0.initial='junk.exr'": ["junk.exr: cannot be read as EXR"],
    "parameters.0.initial='picture.png'": ["initial must be one number or have shape (3,)", "(4, 4, 3)"],
    "parameters.0.initial=[[0.5, 0.5], [0.5]]": ["'paint.reflectance.value'", "differ in length"],
    "parameters.0.initial=1e300": ["initial must be finite"],
    "parameters.0.truth='nowhere.png'": ["truth", "nowhere.png"],
}

# Name -> (bytes of the recipe, fragments of the message).
FILES = {
    "empty": (b"", ["scene: this key is required"]),
    "UTF-16": ("steps = 6".encode("utf-16"), ["not valid TOML"]),
    "NUL": (b"steps = \x00", ["not valid TOML", "line 1"]),
    "a table twice": (b"[render]\nspp = 3\n[render]\nspp = 4\n", ["not valid TOML", "twice"]),
    "nested without end": (b"a = " + b"[" * 5000, ["nested too deeply"]),
    "a name without end": (b"scene = '" + b"a" * 5000 + b"'", ["scene: no such file"]),
}


@pytest.fixture
def refused(folder):
    """Returns a function that gives the message with which the recipe is refused."""
    (folder / "junk.exr").write_bytes(b"junk")
    (folder / "folder").mkdir()

    def message(overrides=()):
        before = sorted(folder.rglob("*"))
        with pytest.raises(ValueError) as caught:
            Recovery(read_recipe(folder / "recipe.toml", overrides))
        assert sorted(folder.rglob("*")) == before
        return str(caught.value)

    return message


@pytest.mark.parametrize("override", OVERRIDES)
def test_a_bad_value_is_refused_by_name(override, refused):
    message = refused([override])
    assert len(message.splitlines()) == 1 and "<class" not in message
    for fragment in OVERRIDES[override]:
        assert fragment in message


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_no_recipe_is_named(name, refused, folder):
    content, expected = FILES[name]
    (folder / "recipe.toml").write_bytes(content)
    message = refused()
    assert message.startswith(str(folder / "recipe.toml"))
    for fragment in expected:
        assert fragment in message


def test_a_byte_order_mark_is_no_fault(folder):
    path = folder / "recipe.toml"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert read_recipe(path).steps == 6
