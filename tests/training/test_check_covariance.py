"""`radbp check --covariance`: deviations, correlations, and what images do not tell, of scenes and recipes."""

import re

import pytest

PAINT, LAMP = "paint.reflectance.value", "lamp.emitter.radiance.value"
BOTH = ["check", "scene.xml", "--covariance", "--param", PAINT, "--param", LAMP, "--max-depth", 2, "--spp", 64]


def deviations(stdout):
    """By name, as printed."""
    rows = (line.split() for line in stdout.splitlines() if line.startswith((PAINT, LAMP)))
    return {row[0]: float(row[2]) for row in rows}


def test_what_is_known_only_as_a_product_is_said(radbp, folder):
    scene = (folder / "scene.xml").read_text()
    (folder / "scene.xml").write_text(re.sub(r'    <shape type="rectangle" id="wall">.*?</shape>\n', "", scene, count=1,
                                             flags=re.DOTALL))
    code, stdout, stderr = radbp(*BOTH)
    assert code == 0, stderr
    for channel in range(3):
        assert f"not told: {PAINT}[{channel}] and {LAMP}[{channel}] only as a product" in stdout
    assert "1 % of the mean" in stdout


def test_a_known_wall_tells_them_and_deviations_are_in_proportion_to_noise(radbp):
    found = []
    for noise in (0.01, 0.02):
        code, stdout, stderr = radbp(*BOTH, "--noise", noise)
        assert code == 0 and "not told" not in stdout, stderr
        assert "correlated: " in stdout or "no correlation above 0.8" in stdout
        found.append(deviations(stdout))
    assert len(found[0]) == 6 and min(found[0].values()) > 0
    for name, deviation in found[0].items():
        assert found[1][name] == pytest.approx(2 * deviation, rel=0.06), "as two digits tell"


def test_a_recipe_has_its_parameters_and_cameras(radbp, folder):
    before = sorted(folder.rglob("*"))
    code, stdout, stderr = radbp("check", "recipe.toml", "--covariance", "--noise", 0.01)
    assert code == 0, stderr
    assert set(deviations(stdout)) == {f"{PAINT}[{channel}]" for channel in range(3)} and " 0.5 " in stdout
    assert sorted(folder.rglob("*")) == before, "it writes nothing"


def test_help_teaches(radbp):
    code, stdout, _ = radbp("check", "--help")
    assert code == 0
    text = " ".join(stdout.split())
    for fragment in ("--covariance", "--noise", "radbp check recipe.toml --covariance", "not told"):
        assert fragment in text


BAD_COMMANDS = {
    "no parameter": (["scene.xml", "--covariance"], "--covariance of a scene needs a --param"),
    "no such parameter": (["scene.xml", "--covariance", "--param", "pint.reflectance.value"], "'pint.reflectance.value'"),
    "a direction": (["scene.xml", "--covariance", "--param", PAINT, "--direction", "ones"], "--direction does not go"),
    "no noise": (["scene.xml", "--covariance", "--param", PAINT, "--noise", "0"], "must be positive"),
    "a parameter beside a recipe": (["recipe.toml", "--covariance", "--param", PAINT], "--param is for scenes"),
    "noise without covariance": (["scene.xml", "--param", PAINT, "--noise", "0.1"], "--noise goes with --covariance"),
    "two without covariance": (["scene.xml", "--param", PAINT, "--param", LAMP], "name one parameter by --param, got 2"),
    "none without covariance": (["scene.xml"], "name one parameter by --param, got 0"),
}


@pytest.mark.parametrize("case", BAD_COMMANDS)
def test_bad_command_is_one_message_and_exit_code_2(case, radbp):
    arguments, expected = BAD_COMMANDS[case]
    code, _, stderr = radbp("check", *arguments)
    message = stderr.strip().splitlines()[-1]
    assert code == 2 and message.startswith("error: ") and expected in message and "Traceback" not in stderr
