"""What the fuzzer starts from: scenes of the assets and of the comparison with Mitsuba, meshes, pictures and recipes.

Everything is written into one folder, so that mutants find the files that their originals refer to.
"""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenEXR
import torch
from PIL import Image

from tests.formats.picture_files import png_of, tiff_of
from tests.formats.serialized_files import mesh, serialized
from tests.io.colmap_files import CAMERAS as CAMERA_LINES
from tests.io.colmap_files import IMAGES as IMAGE_LINES
from tests.io.colmap_files import binary
from tests.io.gltf_everything import everything
from tests.io.gltf_files import SQUARE, GltfFile
from tests.io.nerf_files import BLENDER, OPENCV
from tests.scenes.mesh_attributes import PLY as COLOURED
from tests.scenes.xml.cases import CASES
from tests.scenes.xml.files import Folder
from tests.scenes.xml.matrix import SMALL
from tests.training.conftest import RECIPE, SCENE
from torch_radbp.formats.volume import write_volume
from torch_radbp.plugin import REGISTRY, attributes
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.checkpoint import save_checkpoint
from torch_radbp.training.recovery.problem import Recovery

ROOT = Path(__file__).parents[2]
FAMILIES = {name: f".{name}" for name in ("xml", "obj", "ply", "serialized", "vol", "exr", "png", "bmp", "tga", "hdr",
                                          "pfm", "webp", "tif", "toml", "gltf", "glb")}
FAMILIES |= {"colmap": ".txt", "colmap_binary": ".bin", "nerf": ".json", "checkpoint": ".safetensors"}
NEXT_FILE = b"# the next file\n"  # between cameras and images of a COLMAP model, which mutate as one


class Seed(NamedTuple):
    """A file that loads."""

    folder: Path  # where a mutant of it is to be written
    content: bytes


def build_corpus(root: Path) -> dict[str, list[Seed]]:
    """The seeds of every family, and in `root` the files that they refer to."""
    folders = {name: root / name for name in ("meshes", "images", "recipe")}
    for folder in folders.values():
        folder.mkdir()
    shutil.copytree(ROOT / "assets", root / "assets")
    shutil.copytree(ROOT / "training" / "recipes", root / "training" / "recipes")
    image_seeds = {name: [] for name in ("exr", "png", "bmp", "tga", "hdr", "pfm", "webp", "tif")}
    for path in [*_images(folders["images"]), *sorted((root / "assets").glob("*/*.png"))]:
        image_seeds[path.suffix[1:]].append(Seed(folders["images"], path.read_bytes()))
    return {
        "xml": _scenes(root),
        "obj": [Seed(folders["meshes"], text.encode()) for text in OBJ],
        "ply": [Seed(folders["meshes"], content) for content in (PLY, COLOURED_BYTES, _binary_ply("<"), _binary_ply(">"))],
        "serialized": [Seed(folders["meshes"], content) for content in SERIALIZED],
        "vol": [Seed(folders["meshes"], content) for content in VOLUMES],
        **image_seeds,
        "toml": _recipes(root, folders["recipe"]),
        "checkpoint": _checkpoints(root),
        **_assets(root),
        **_cameras(root),
    }


def _cameras(root: Path) -> dict[str, list[Seed]]:
    """Cameras of every model that COLMAP and NeRF data sets have; images beside them tell the size of some."""
    folders = {name: root / name for name in ("colmap", "colmap_binary", "nerf")}
    for folder in folders.values():
        folder.mkdir()
    (folders["nerf"] / "train").mkdir()
    Image.new("RGB", (8, 6)).save(folders["nerf"] / "train" / "r_0.png")
    pose = BLENDER["frames"][0]["transform_matrix"]
    lists_more = BLENDER | {"frames": [{"file_path": f"train/r_{n}", "transform_matrix": pose} for n in range(4)]}
    skewed = [[1.0, 2e-3, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
    radial = OPENCV | {"camera_model": "RADIAL", "p1": 0, "p2": 0, "is_fisheye": True, "frames": [
        {"file_path": "a.jpg", "transform_matrix": skewed, "camera_angle_x": 0.8}]}
    every = "".join(f"{number} 1 0.1 {0.1 * number} 0 0 0 2 {number} {number}.jpg\n\n" for number in range(1, 14))
    fisheye = OPENCV | {"camera_model": "OPENCV_FISHEYE", "p1": 0, "p2": 0, "k4": 0.01}
    binaries = [NEXT_FILE.join((model / f"{name}.bin").read_bytes() for name in ("cameras", "images"))
                for model in (binary(folders["colmap_binary"], images=images) for images in (IMAGE_LINES, every))]
    return {"colmap": [Seed(folders["colmap"], NEXT_FILE.join((CAMERA_LINES.encode(), images.encode())))
                       for images in (IMAGE_LINES, every)],
            "colmap_binary": [Seed(folders["colmap_binary"], content) for content in binaries],
            "nerf": [Seed(folders["nerf"], json.dumps(document, indent=1).encode())
                     for document in (BLENDER, OPENCV, fisheye, BLENDER | {"is_fisheye": True, "k1": 0.1}, lists_more,
                                      radial)]}


def _assets(root: Path) -> dict[str, list[Seed]]:
    """glTF files of everything that is read, and of strips and sparse accessors."""
    folder = root / "gltf"
    folder.mkdir()
    strip, sparse = GltfFile(), GltfFile()
    strip.node(strip.square() | {"mode": 5}, {"attributes": {"POSITION": strip.array(SQUARE)}, "mode": 6}, name="strip")
    square = sparse.square()
    sparse.document["accessors"][square["attributes"]["POSITION"]]["sparse"] = {
        "count": 1, "indices": {"bufferView": sparse.view(b"\2"), "componentType": 5121},
        "values": {"bufferView": sparse.view(bytes(12))}}
    sparse.node(square, name="sheet", matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 0, 0, 1])
    people = GltfFile()  # what exporters write: copies, hidden nodes, colours above 1, corners too many, no area
    copies = {"TRANSLATION": people.array([[0, 0, 0], [0.5, 0, -1]]), "SCALE": people.array([[1, 1, 1], [0.5, 0.5, 0.5]])}
    people.node(people.square(COLOR_0=people.array([[0.1, 0.2, 0.3]] * 4)), name="leaf",
                extensions={"EXT_mesh_gpu_instancing": {"attributes": copies}})
    people.node(people.square(), name="hidden", extensions={"KHR_node_visibility": {"visible": False}})
    bright = people.square(COLOR_0=people.array([[1.5, 0.2, 0.3]] * 4))
    people.node(bright | {"indices": people.array([0, 1, 2, 3], "uint16")},
                {"attributes": {"POSITION": people.array([[0, 0, 0]] * 3)}}, name="odd", children=[])
    files = [everything(), everything(), strip, sparse, people]
    seeds = {kind: [Seed(folder, file.save(folder / f"seed.{kind}").read_bytes()) for file in files]
             for kind in ("gltf", "glb")}
    seeds["glb"].append(Seed(folder, (root / "assets" / "pot" / "pot.glb").read_bytes()))
    return seeds


def _scenes(root: Path) -> list[Seed]:
    """Those of the assets and of the comparison, and one of the plugins that those lack."""
    seeds = [Seed(path.parent, path.read_bytes()) for path in sorted((root / "assets").glob("*/scene.xml"))]
    for name, case in CASES.items():
        folder = root / "scenes" / name.replace(" ", "_")
        folder.mkdir(parents=True)
        content = case.build(Folder(folder)).read_bytes()
        for variable, value in SMALL.items():  # that have no default
            content = content.replace(f"${variable}".encode(), str(value).encode())
        seeds.append(Seed(folder, content))
    box = next(seed for seed in seeds if seed.folder == root / "assets" / "cornell_box")
    (box.folder / "part.xml").write_bytes(box.content)
    including = b'<scene version="3.0.0"><include filename="part.xml"/><path value="../poster"/></scene>'
    (root / "others").mkdir()
    (root / "others" / "coloured.ply").write_text(COLOURED)
    write_volume(root / "others" / "smoke.vol", np.linspace(0, 1, 12, dtype="f4").reshape(3, 2, 2, 1))
    write_volume(root / "others" / "flakes.vol", np.array([0.9, 0.3, 0.5, 0.2, -0.1, 0.1], "f4").reshape(1, 1, 1, 6))
    seeds += [Seed(box.folder, box.content.replace(b'type="path"', f'type="{name}"'.encode()))
              for name in ("prb_basic", "prb_projective", "prbvolpath", "ptracer", "volpath", "volpathmis")]
    direct = '<integrator type="direct"><integer name="shading_samples" value="1"/>'
    plain = OTHERS.format("").replace('<integrator type="prb" name="image"><integer name="max_depth" value="3"/>', direct)
    projective = plain.replace(direct, '<integrator type="direct_projective">')
    seeds += [Seed(root / "others", text.encode()) for text in (plain, projective)]
    seeds += [Seed(root / "others", FOG.format(phase).encode()) for phase in PHASES]
    seeds += [Seed(root / "others", CAMERAS.replace("independent", name).encode()) for name in ("orthogonal", "stratified")]
    return [*seeds, Seed(box.folder, including), Seed(root / "others", _others().encode()),
            Seed(root / "others", OLD.encode())]


def _others() -> str:
    """A scene of every spectrum, texture and material that needs no other object."""
    types = [name for name, plugin in REGISTRY["bsdf"].items()
             if not any(attribute.required for attribute in attributes(plugin).values())]
    colours = [f'<bsdf type="diffuse">{spectrum}</bsdf>' for spectrum in SPECTRA]
    shapes = "".join(f'<shape type="rectangle"><transform name="to_world"><translate x="{0.1 * number}" z="{-number}"/>'
                     f'</transform>{material}</shape>'
                     for number, material in enumerate([*colours, *(f'<bsdf type="{name}"/>' for name in types)]))
    return OTHERS.format(shapes)


def _recipes(root: Path, folder: Path) -> list[Seed]:
    (folder / "scene.xml").write_text(SCENE)
    pixels = np.random.default_rng(0).uniform(0, 1, (6, 8, 3)).astype("f4")
    _write_exr(folder / "target.exr", {"RGB": pixels})
    Image.fromarray((pixels[:4, :4] * 255).astype("u1")).save(folder / "picture.png")
    shipped = root / "training" / "recipes"
    seeds = [Seed(shipped, path.read_bytes()) for path in sorted(shipped.glob("*.toml"))]
    return [Seed(folder, RECIPE.encode())] * 4 + seeds


def _checkpoints(root: Path) -> list[Seed]:
    """States after a step of every optimiser, each in a folder with its recipe."""
    seeds = []
    for name in ("adam", "sgd", "rmsprop"):
        folder = root / f"run_{name}"
        folder.mkdir()
        for file in ("scene.xml", "target.exr", "picture.png"):
            shutil.copyfile(root / "recipe" / file, folder / file)
        momentum = "momentum = 0.5\n" if name != "adam" else ""
        (folder / "recipe.toml").write_text(RECIPE.replace('name = "adam"\n', f'name = "{name}"\n{momentum}'))
        recovery = Recovery(read_recipe(folder / "recipe.toml"))
        take_step(recovery)
        save_checkpoint(folder / "seed.safetensors", recovery.state_dict())
        seeds.append(Seed(folder, (folder / "seed.safetensors").read_bytes()))
    return seeds


def take_step(recovery: Recovery) -> None:
    """A step along a made-up gradient."""
    for parameter in recovery.parameters:
        parameter.raw.grad = torch.ones_like(parameter.raw)
    for optimizer in recovery.optimizers.values():
        optimizer.step()
    recovery.end(recovery.step)


def _write_exr(path: Path, channels: dict[str, np.ndarray], compression: str = "ZIP", kind=OpenEXR.scanlineimage) -> Path:
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": kind}
    if kind == OpenEXR.tiledimage:
        header["tiles"] = OpenEXR.TileDescription()
    OpenEXR.File(header, channels).write(str(path))
    return path


def _images(folder: Path) -> list[Path]:
    """Small images of every compression and mode."""
    random = np.random.default_rng(0)
    pixels = random.uniform(0, 1, (9, 7, 3)).astype("f4")
    paths = [_write_exr(folder / f"{name}.exr", {"RGB": pixels.astype(dtype)}, name)
             for name, dtype in (("NO", "f4"), ("RLE", "f2"), ("ZIPS", "f4"), ("ZIP", "f4"), ("PIZ", "f2"), ("PXR24", "f4"),
                                 ("B44", "f2"), ("DWAA", "f2"))]
    paths.append(_write_exr(folder / "layers.exr", {"beauty.R": pixels[..., 0], "beauty.G": pixels[..., 1],
                                                    "beauty.B": pixels[..., 2], "A": pixels[..., 0]}))
    paths.append(_write_exr(folder / "grey.exr", {"Y": pixels[..., 0]}))
    with_alpha = random.uniform(0, 1, (9, 7, 4)).astype("f4")
    paths.append(_write_exr(folder / "tiled.exr", {"RGBA": with_alpha}, kind=OpenEXR.tiledimage))
    colours = Image.fromarray((pixels * 255).astype("u1"))
    for mode in ("RGB", "RGBA", "L", "LA", "P", "1"):
        colours.convert(mode).save(folder / f"{mode}.png")
        paths.append(folder / f"{mode}.png")
    Image.fromarray((pixels[..., 0] * 65535).astype("u2")).save(folder / "deep.png")
    for name, options in (("plain.bmp", {}), ("plain.tga", {}), ("packed.tga", {"compression": "tga_rle"})):
        colours.save(folder / name, **options)
        paths.append(folder / name)
    for name, options in (("plain.webp", {"lossless": True}), ("lossy.webp", {}),
                          ("packed.tif", {"compression": "tiff_lzw"}), ("deflated.tif", {"compression": "tiff_deflate"})):
        colours.convert("RGBA" if "plain" in name else "RGB").save(folder / name, **options)
        paths.append(folder / name)
    words = (with_alpha * 65535).astype("u2")
    contents = {"grey_and_alpha.png": png_of(words[..., :2]), "deep_with_alpha.png": png_of(words),
                "key.png": png_of(words[..., :3], tuple(words[2, 3, :3].tolist())), "grey.tif": tiff_of(words[..., :1]),
                "white.tif": tiff_of(words[..., :1], bits=16, PhotometricInterpretation=0),
                "deep.tif": tiff_of(words[..., :3], ">"), "deep_with_alpha.tif": tiff_of(words, ExtraSamples=2),
                "plain.tif": tiff_of(words[..., :3] >> 8, bits=8, Orientation=6)}
    plain, row = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 8\n", b"\x02\x02\x00\x08" + 4 * b"\x83\x80\x05abcde"
    contents |= {"plain.hdr": plain + bytes(range(64, 128)), "packed.hdr": plain + 2 * row,
                 "colours.pfm": b"PF\n7 9\n-1\n" + pixels.tobytes(),
                 "grey.pfm": b"Pf\n7 27\n1\n" + pixels.astype(">f4").tobytes()}
    for name, content in contents.items():
        (folder / name).write_bytes(content)
        paths.append(folder / name)
    return [*paths, folder / "deep.png"]


def _volume(*size: int) -> bytes:
    """A volume of random distances, of a size along x, y and z."""
    values = np.random.default_rng(1).uniform(-1, 1, int(np.prod(size))).astype("<f4")
    return struct.pack("<3sB5i6f", b"VOL", 3, 1, *size, 1, 0, 0, 0, 1, 1, 1) + values.tobytes()


SPECTRA = [
    '<spectrum name="reflectance" value="400:0.1, 550:0.6, 700:0.3"/>',
    '<spectrum name="reflectance" type="irregular"><string name="wavelengths" value="400, 500, 700"/>'
    '<string name="values" value="0.1, 0.5, 0.3"/></spectrum>',
    '<spectrum name="reflectance" type="regular"><float name="wavelength_min" value="400"/>'
    '<float name="wavelength_max" value="700"/><string name="values" value="0.1, 0.5, 0.3"/></spectrum>',
    '<spectrum name="reflectance" type="uniform"><float name="value" value="0.4"/></spectrum>',
    '<texture name="reflectance" type="srgb"><rgb name="color" value="0.2, 0.5, 0.7"/></texture>',
    '<texture name="reflectance" type="rawconstant"><rgb name="value" value="0.2, 0.5, 0.7"/></texture>',
    '<texture name="reflectance" type="checkerboard"><rgb name="color0" value="0.2, 0.5, 0.7"/>'
    '<transform name="to_uv"><scale value="3"/></transform></texture>',
]
CAMERAS = """<scene version="3.0.0">
  <sensor type="batch">
    <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="8"/></film>
    <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
    <sensor type="calibrated"><float name="fx" value="9"/><float name="cx" value="4"/><float name="cy" value="3.5"/>
      <float name="k1" value="-0.1"/><float name="p2" value="0.01"/></sensor>
    <sensor type="calibrated"><float name="fx" value="5"/><float name="cx" value="4"/><float name="cy" value="3.5"/>
      <string name="distortion" value="fisheye"/><float name="k1" value="0.05"/></sensor>
  </sensor>
  <emitter type="constant"/>
  <shape type="sphere"><point name="center" x="0" y="0" z="4"/></shape>
</scene>
"""
OTHERS = """<scene version="3.0.0">
  <integrator type="moment"><integrator type="aov" name="inner"><string name="aovs" value="dd.y:depth, nn:sh_normal"/>
    <integrator type="prb" name="image"><integer name="max_depth" value="3"/></integrator></integrator></integrator>
  <sensor type="perspective">
    <float name="fov" value="50"/>
    <transform name="to_world"><lookat origin="0.3, 0.4, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
    <sampler type="ldsampler"><integer name="sample_count" value="4"/></sampler>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
  </sensor>
  <emitter type="constant">
    <spectrum name="radiance" type="d65"><float name="scale" value="0.02"/></spectrum>
  </emitter>
  <emitter type="point">
    <spectrum name="intensity" type="blackbody"><float name="temperature" value="4000"/></spectrum>
  </emitter>
  <shape type="ply">
    <string name="filename" value="coloured.ply"/>
    <bsdf type="diffuse">
      <texture name="reflectance" type="mesh_attribute"><string name="name" value="vertex_color"/></texture>
    </bsdf>
  </shape>
  {}
</scene>
"""
FOG = """<scene version="3.0.0">
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0.3, 0.4, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
    <medium type="homogeneous">
      <rgb name="sigma_t" value="0.1, 0.2, 0.3"/> <float name="scale" value="0.5"/>
      <volume name="albedo" type="constvolume"><float name="value" value="0.6"/></volume>
      {}
    </medium>
  </sensor>
  <emitter type="point"><point name="position" x="0" y="2" z="3"/></emitter>
  <shape type="cube">
    <bsdf type="null"/>
    <medium name="interior" type="heterogeneous">
      <volume name="sigma_t" type="gridvolume"><string name="filename" value="smoke.vol"/></volume> <phase type="hg"/>
    </medium>
  </shape>
  <shape type="sphere">
    <bsdf type="diffuse"><texture name="reflectance" type="volume">
      <volume type="gridvolume"><string name="filename" value="smoke.vol"/></volume>
    </texture></bsdf>
  </shape>
</scene>
"""
SMOKE = """<volume name="{}" type="gridvolume"><string name="filename" value="{}"/><string name="wrap_mode" value="{}"/>
    <boolean name="use_grid_bbox" value="true"/></volume>"""
PHASES = (
    '<phase type="isotropic"/>', '<phase type="rayleigh"/>', '<phase type="hg"><float name="g" value="0.3"/></phase>',
    '<phase type="tabphase"><string name="values" value="0.5, 0.1, 2"/></phase>',
    f'<phase type="sggx">{SMOKE.format("S", "flakes.vol", "repeat")}</phase>',
    f'<phase type="blendphase">{SMOKE.format("weight", "smoke.vol", "mirror")} <phase type="hg"/><phase type="hg"/></phase>')
OLD = """<scene version="0.6.0">
  <default name="maxDepth" value="3"/>
  <integrator type="path"><integer name="maxDepth" value="$maxDepth"/></integrator>
  <sampler type="multijitter" id="points"><integer name="sampleCount" value="4"/></sampler>
  <sensor type="perspective">
    <transform name="toWorld"><lookAt origin="0.3, 0.4, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
    <ref id="points"/>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
  </sensor>
  <emitter type="area" id="lamp"><rgb name="radiance" value="1, 2, 3"/></emitter>
  <shape type="sphere"><ref id="lamp"/></shape>
  <shape type="cube">
    <transform name="toWorld"><translate y="-2"/></transform>
    <bsdf type="diffuse">
      <texture name="diffuseReflectance" type="checkerboard">
        <float name="uscale" value="2"/><float name="voffset" value="0.3"/>
      </texture>
    </bsdf>
  </shape>
</scene>
"""
OBJ = [
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    """# a box without a lid
mtllib box.mtl
o box
v -1 -1 0.0
v 1 -1 0.0
v 1 1 0.0
v -1 1 0.0
v -1.0 -1.0 1e0
v 1.0 -1.0 1.0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
vn 0 -1 0
usemtl grey
s off
f 1/1/1 2/2/1 3/3/1 4/4/1
g side
f -6/1/-1 -5/2/-1 -1/3/-1 -2/4/-1
""",
    "v 0 0 0 1\nv 1 0 0 .5 .5 .5\nv 1 1 0\nv 0 1 0.25\nvn 0 0 1\nvn .1 0 1\nf 1//1 2//2 3//1\nf 1//1 \\\n 3//1 4//2\n",
    "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nvn nan 0 1\nf 1/1/1 2/1/1 3/1/1\nf 1//1 3 4//2\nf 1 2\n"
    "cstype bspline\ndeg 1\ncurv 0 1 1 2\nparm u 0 0 1 1\nend\n",
    "v 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nv 0 1 0\r\nvt 0 0\r\nvt 1 .5 0\r\nf 1/1 2/2 3/1 4/2\r\nl 1 2\r\np 3\r\n",
]
CORNERS, UV = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]], [[0, 0], [1, 0], [1, 1], [0, 1]]
FACES, NORMALS = [[0, 1, 2], [0, 2, 3]], [[0, 0, 1], [0, 1, 1], [0.1, 1, 1], [0, 0, 1]]
VOLUMES = [_volume(3, 4, 2), _volume(40, 5, 6)]
SERIALIZED = [
    serialized(mesh(CORNERS, FACES, 3), mesh(CORNERS, FACES, 3, double=True, normals=NORMALS)),
    serialized(mesh(CORNERS, FACES, normals=NORMALS, uv=UV, colours=NORMALS)),
    mesh(CORNERS, FACES, flags=0x10),
]
COLOURED_BYTES = b"""ply
format ascii 1.0
element vertex 5
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
element face 3
property list float int vertex_indices
end_header
0 0 0 0 0 1 255 0 9
1 0 0 0 0 1 0 128 9
1 1 0 0 0 1 0 0 9
0 1 0 0 0 0 0 0 9
7 7 7 0 0 0 0 0 9
3 0 1 2
3 0 2 3
2 0 1
"""
PLY = b"""ply
format ascii 1.0
comment four corners
element vertex 4
property float x
property float y
property float z
property float nx
property float ny
property float nz
property float u
property float v
property uchar red
element face 2
property uchar flags
property list uchar int vertex_indices
element edge 1
property int a
property list uchar short b
end_header
0 0 0 0 0 1 0 0 255
1 0 0 0 0 1 1 0 0
1 1 0 0 0.1 1 1 1 9
0 1 0.5 0 0 1 0 1 7
0 3 0 1 2
1 4 0 1 2 3
5 2 1 2
"""


def _binary_ply(order: str) -> bytes:
    header = PLY[:PLY.index(b"end_header\n") + 11]
    rows = [line.split() for line in PLY[len(header):].decode().splitlines()]
    body = b"".join(struct.pack(f"{order}8fB", *map(float, row[:8]), int(row[8])) for row in rows[:4])
    for row in rows[4:6]:
        body += struct.pack(f"{order}BB{len(row) - 2}i", *map(int, row))
    body += struct.pack(f"{order}iB2h", *map(int, rows[6]))
    return header.replace(b"ascii", b"binary_little_endian" if order == "<" else b"binary_big_endian") + body
