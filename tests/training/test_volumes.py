"""Volumes that are recovered: how a recipe names them, and how a report shows them."""

import xml.etree.ElementTree as ElementTree

import torch
from rich.console import Console

import torch_radbp as rb
from torch_radbp.formats.image import read_image, save_image
from torch_radbp.formats.volume import write_volume
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.optimize import render_buffers
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.volume_picture import volume_picture
from torch_radbp.training.run import run

SCENE = """<scene version="3.0.0">
    <sensor type="perspective" id="camera">
        <float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0.5, 0.5, 4" target="0.5, 0.5, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/><rfilter type="box"/></film>
    </sensor>
    <shape type="cube" id="smoke">
        <transform name="to_world"><scale value="0.5"/><translate x="0.5" y="0.5" z="0.5"/></transform>
        <bsdf type="null"/>
        <medium type="heterogeneous" name="interior">
            <volume type="gridvolume" name="sigma_t"><string name="filename" value="smoke.vol"/></volume>
        </medium>
    </shape>
    <emitter type="constant" id="sky"/>
</scene>
"""
RECIPE = """scene = "scene.xml"
steps = 3

[[targets]]
image = "target.exr"

[[parameters]]
name = "smoke.interior.sigma_t.data"
initial = 0.5
bounds = [0.0, 3.0]
parametrisation = "sigmoid"
coarse_to_fine = { cells = [2, 2, 2], double_at = [1] }
truth = "scene"

[render]
spp = 2
compile = false

[[loss]]
name = "two_buffer_l2"

[optimizer]
name = "adam"
"""


def test_info_shows_media_with_their_extinction_and_where_they_are(radbp, folder):
    write_volume(folder / "smoke.vol", torch.linspace(0, 0.5, 24).view(2, 3, 4, 1).numpy())
    (folder / "scene.xml").write_text(SCENE.replace('name="interior">', 'name="interior"><float name="scale" value="8"/>'))
    code, stdout, _ = radbp("info", "scene.xml")
    row, = [line for line in stdout.splitlines() if "heterogeneous" in line and "smoke.interior" in line]
    assert code == 0 and "0 to 4" in row and "2 x 3 x 4 x 1" in row and "in smoke" in row
    assert "smoke.interior.sigma_t.data" in stdout
    html = ElementTree.fromstring(f"<all>{rb.load(folder / 'scene.xml')._repr_html_()}</all>")
    assert ["smoke.interior", "heterogeneous"] in [[cell.text for cell in row] for row in html.iter("tr")]


def test_info_says_which_medium_is_around_the_sensors(radbp, folder):
    medium = ('<medium type="homogeneous" name="medium"><float name="sigma_t" value="0.25"/>'
              '<rgb name="emission" value="0.5, 1, 2"/></medium>')
    scene = (folder / "scene.xml").read_text().replace('<float name="fov"', f'{medium}<float name="fov"')
    (folder / "scene.xml").write_text(scene)
    code, stdout, _ = radbp("info", "scene.xml")
    row, = [line for line in stdout.splitlines() if "around all sensors" in line]
    assert code == 0 and "homogeneous" in row and "0.25" in row and "0.5 to 2" in row


def test_a_report_shows_slices_and_sums_of_a_volume(tmp_path):
    density = torch.rand(4, 5, 6, 1, generator=torch.Generator().manual_seed(0))
    write_volume(tmp_path / "smoke.vol", density.numpy())
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    save_image(tmp_path / "target.exr", rb.render(rb.load(tmp_path / "scene.xml"), spp=4)[0].detach())
    summary, _ = run(tmp_path / "recipe.toml", [], tmp_path / "run", False, Console(quiet=True))
    parameter, = summary["parameters"]
    assert parameter["picture"] and parameter["shape"] == [4, 5, 6, 1]
    pictures = {role: read_image(tmp_path / "run" / "textures" / f"smoke.interior.sigma_t.data_{role}.png")
                for role in ("before", "recovered", "true")}
    assert {picture.shape for picture in pictures.values()} == {(2 * 6 + 1, 3 * 6 + 2, 3)}
    torch.testing.assert_close(pictures["true"], volume_picture(density, density).expand(-1, -1, 3), atol=0.01, rtol=0)
    text = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "slices through the middle" in text and text.count("data:image/png") == 4 + 3


def test_a_volume_is_seen_along_each_axis_with_y_upwards():
    density = torch.zeros(4, 4, 4, 1)
    density[2, 3, 1] = 2.0  # z, y, x
    density[2, 3, 2] = 1.0
    picture = volume_picture(density, density)[..., 0]
    assert picture.shape == (9, 14)
    along_z, sum_along_y = picture[:4, 10:], picture[5:, 5:9]
    assert along_z[0].tolist() == [0, 1, 0.5, 0] and not along_z[1:].any(), "y upwards, x to the right"
    torch.testing.assert_close(sum_along_y[1], torch.tensor([0, 2 / 3, 1 / 3, 0]))  # sums along x are up to 3
    assert (picture[4] == 1).all() and (picture[:, 4] == 1).all(), "white between the parts"


def test_a_network_in_the_place_of_a_grid_is_read_at_its_cells(tmp_path):
    """Its weights are what is optimised, and the values at the centres of cells what is rendered and saved."""
    write_volume(tmp_path / "smoke.vol", torch.full((4, 5, 6, 1), 0.2).numpy())
    (tmp_path / "scene.xml").write_text(SCENE)
    save_image(tmp_path / "target.exr", rb.render(rb.load(tmp_path / "scene.xml"), spp=4)[0].detach())
    own = RECIPE[RECIPE.index("initial"):RECIPE.index("truth")]
    network = 'parametrisation = "network"\nnetwork = { waves = 8, frequency = 3.0, width = 16 }\nbounds = [0.0, 0.5]\n'
    (tmp_path / "recipe.toml").write_text(RECIPE.replace(own, network))
    recovery = Recovery(read_recipe(tmp_path / "recipe.toml"))
    parameter, = recovery.parameters
    grid = recovery.scene.smoke.interior.sigma_t
    assert parameter.raw.shape == (16 * 17 + 16 * 17 + 17,) and grid.data.shape == (4, 5, 6, 1)
    place = torch.tensor([[3.5 / 6, 1.5 / 5, 2.5 / 4]])  # x, y and z
    value = grid.parametrizations.data[0].network(parameter.raw, place)
    torch.testing.assert_close(grid.data[2, 1, 3], value[0])
    sum(buffer.sum() for buffer in render_buffers(recovery, 0)).backward()
    assert parameter.raw.grad.isfinite().all() and parameter.raw.grad.abs().max() > 0
