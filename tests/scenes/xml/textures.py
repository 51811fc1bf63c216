"""Scenes of textures that are neither colours nor images, and of spectra."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from tests.scenes.xml.files import Folder, bitmap, look, picture, placed, scene_xml, shape, size

BOARD = ('<texture type="checkerboard" name="{}">{}<transform name="to_uv"><rotate z="1" angle="20"/>'
         '<scale x="2.3" y="1.7"/></transform></texture>')
COLOURS = '<rgb name="color0" value="0.7, 0.3, 0.1"/><spectrum name="color1" value="400:0.1, 500:0.7, 600:0.3, 720:0.2"/>'
GREEN = "# nanometres, reflectance\n380 0.05\n470 0.2\n530 0.8\n600 0.3\n730 0.1\n"
FACTORS = ("0.2 0.8", "0.9 0.3")  # of the two faces of a panel


def coloured(folder: Folder) -> None:
    """A panel whose vertices have colours, and whose faces have numbers."""
    colours = np.round(picture(1, 4, seed=8)[0], 3).tolist()
    corners = [(-1, -1, 0), (1, -1, 0.3), (1, 1, 0), (-1, 1, 0.3)]
    rows = [" ".join(map(str, (*corner, *colour))) for corner, colour in zip(corners, colours)]
    columns = "".join(f"property float {name}\n" for name in ("x", "y", "z", "r", "g", "b"))
    folder.text("panel.ply", f"ply\nformat ascii 1.0\nelement vertex 4\n{columns}element face 2\n"
                "property list uchar int vertex_indices\nproperty float shade_x\nproperty float gloss_x\nend_header\n"
                + "\n".join([*rows, f"3 0 1 2 {FACTORS[0]}", f"3 0 2 3 {FACTORS[1]}"]) + "\n")


def coloured_ball(folder: Folder, name: str) -> None:
    """A ball as PLY, its vertices with normals, coordinates and colours, its faces with numbers between 0.1 and 0.9."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    colours = np.round(picture(1, len(ball.vertices), seed=9)[0], 3)
    shades = np.round(0.1 + 0.8 * np.random.default_rng(10).random(len(ball.faces)), 3)
    x, y, z = ball.vertices.T
    uv = np.stack([0.5 + 0.4 * x + 0.1 * z, 0.5 + 0.4 * y - 0.1 * z], axis=1)
    table = np.round(np.hstack([ball.vertices, ball.vertices, uv, colours]), 6)
    columns = "".join(f"property float {each}\n" for each in ("x", "y", "z", "nx", "ny", "nz", "u", "v", "r", "g", "b"))
    rows = [" ".join(map(str, row)) for row in table.tolist()]
    rows += [f"3 {a} {b} {c} {shade}" for (a, b, c), shade in zip(ball.faces.tolist(), shades.tolist())]
    folder.text(name, f"ply\nformat ascii 1.0\nelement vertex {len(table)}\n{columns}element face {len(ball.faces)}\n"
                "property list uchar int vertex_indices\nproperty float shade_x\nend_header\n" + "\n".join(rows) + "\n")


def attribute(name: str, of: str, factor: float = 1.0) -> str:
    return (f'<texture type="mesh_attribute" name="{name}"><string name="name" value="{of}"/>'
            f'<float name="scale" value="{factor}"/></texture>')


def textures(folder: Folder) -> Path:
    """Tiles of checkerboards, of attributes of a mesh and of spectra, under a checkered lamp and a bluish spectrum."""
    folder.pixels("a.png", picture(6, 6, seed=31))
    folder.text("green.spd", GREEN)
    coloured(folder)
    mixed = '<float name="color0" value="0.8"/>' + bitmap("color1", "a.png")
    rough = '<float name="color0" value="0.5"/><float name="color1" value="0.15"/>'
    panel = '<string name="filename" value="panel.ply"/><boolean name="face_normals" value="true"/>'
    materials = [
        ("rectangle", "", f'<bsdf type="diffuse">{BOARD.format("reflectance", COLOURS)}</bsdf>'),
        ("rectangle", "", f'<bsdf type="diffuse">{BOARD.format("reflectance", mixed)}</bsdf>'),
        ("rectangle", "", '<bsdf type="roughconductor"><string name="distribution" value="ggx"/>'
                          f'{BOARD.format("alpha", rough)}</bsdf>'),
        ("rectangle", "", '<bsdf type="diffuse"><spectrum name="reflectance" filename="green.spd"/></bsdf>'),
        ("ply", panel, f'<bsdf type="diffuse">{attribute("reflectance", "vertex_color")}</bsdf>'),
        ("ply", panel, f'<bsdf type="diffuse">{attribute("reflectance", "face_shade", 0.9)}</bsdf>'),
        ("ply", panel, '<bsdf type="roughconductor"><string name="distribution" value="ggx"/>'
                       f'{attribute("alpha", "face_gloss", 0.5)}</bsdf>'),
        ("rectangle", "", '<bsdf type="conductor"><spectrum name="eta" value="400:1.2, 550:0.4, 700:0.2"/>'
                          '<spectrum name="k" value="400:1.9, 550:2.4, 700:3.8"/></bsdf>'),
    ]
    tiles = [shape(kind, f"tile_{k}", more, material, placed(
        'scale value="0.47"', f'translate x="{k % 4 - 1.5}" y="{0.5 - k // 4}"'))
        for k, (kind, more, material) in enumerate(materials)]
    board = BOARD.format("radiance", '<float name="color0" value="1"/><rgb name="color1" value="0.2, 0.5, 0.9"/>')
    tiles.append(shape("rectangle", "lamp", f'<emitter type="area">{board}</emitter>', placed(
        'scale value="1.5"', 'rotate x="1" angle="145"', 'translate y="2.2" z="1.5"')))
    sky = '<emitter type="constant"><spectrum name="radiance" value="400:0.5, 480:0.45, 600:0.25, 720:0.2"/></emitter>'
    return folder.text("scene.xml", scene_xml(size(48, 24), look("0.3, 0.2, 4.2", "0, 0, 0", 52), "".join(tiles) + sky,
                                              '<integer name="max_depth" value="3"/>'))
