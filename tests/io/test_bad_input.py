"""Bad scenes get one message that names the place and what is supported."""

import numpy as np
import pytest
import torch

from tests.io.documents import LAMP, SENSOR, TRIANGLE_OBJ, scene_dict, scene_text, write_scene
from torch_radbp.formats.image import save_image
from torch_radbp.io.load import load, load_dict
from torch_radbp.plugin import SceneError

pytestmark = pytest.mark.hostile


def shape(content, kind="rectangle"):
    return f'<shape type="{kind}" id="wall">{content}</shape>'


def diffuse(content):
    return shape(f'\n<bsdf type="diffuse" id="white">{content}</bsdf>')


# What stands in lines 2 and following of scene.xml; what the message must contain, in this order.
XML = {
    "unknown plugin": (
        shape("", "rectangel"),
        [
            'line 2: <shape type="rectangel" id="wall">',
            "'rectangel' is not supported",
            "did you mean 'rectangle'",
            "known: cube, cylinder, disk",
        ],
    ),
    "plugin of another category": (
        '<bsdf type="sphere"/>',
        ['line 2: <bsdf type="sphere">', "'sphere' is a shape, not a bsdf"],
    ),
    "unknown element": ("<material/>", ["line 2: <material>", "not supported", "shape, bsdf"]),
    "unsupported element": ('<field type="constfield"/>', ["line 2: <field", "fields are not supported"]),
    "unknown attribute": (
        diffuse('\n<rgb name="reflectence" value="1"/>'),
        [
            'line 4: <rgb name="reflectence"> of <bsdf type="diffuse" id="white">',
            "no attribute 'reflectence'",
            "did you mean 'reflectance'",
        ],
    ),
    "negative reflectance": (diffuse('<rgb name="reflectance" value="-0.1"/>'), ["line 3", "at least 0, got -0.1"]),
    "nan": (
        diffuse('<rgb name="reflectance" value="nan"/>'),
        ['line 3: <rgb name="reflectance">', "finite numbers", "'nan'"],
    ),
    "infinity": (
        shape('<transform name="to_world"><scale value="inf"/></transform>'),
        ["line 2: <scale>", "finite", "'inf'"],
    ),
    "wrong number of components": (
        diffuse('<rgb name="reflectance" value="1, 2"/>'),
        ["<rgb", "1 or 3 numbers, got 2"],
    ),
    "hexadecimal colour": (
        diffuse('<rgb name="reflectance" value="#ff8000"/>'),
        ["line 3: <rgb", "three linear RGB numbers"],
    ),
    "wavelengths": (
        diffuse('<spectrum name="reflectance" value="400:0.1, 700:0.2:3"/>'),
        ["line 3: <spectrum", "pairs of a wavelength and a value", "'700:0.2:3'"],
    ),
    "order of wavelengths": (
        diffuse('<spectrum name="reflectance" value="700:0.1, 400:0.2"/>'),
        ["line 3: <spectrum", "wavelengths of a spectrum must increase, got 700 and then 400"],
    ),
    "one wavelength": (
        diffuse('<spectrum name="reflectance" value="700:0.1"/>'),
        ["line 3: <spectrum", "at least two wavelengths, got 1"],
    ),
    "spectrum from a file that is not there": (
        diffuse('<spectrum name="reflectance" filename="a.spd"/>'),
        ["line 3: <spectrum", "filename 'a.spd' not found; looked in"],
    ),
    "spectrum from another file": (
        diffuse('<spectrum name="reflectance" filename="empty.obj"/>'),
        ["line 3: <spectrum", "empty.obj: unknown kind of spectrum '.obj'; supported: .spd"],
    ),
    "glow of a surface": (
        diffuse('<spectrum type="blackbody" name="reflectance"><float name="temperature" value="5000"/></spectrum>'),
        ['<bsdf type="diffuse"', "a blackbody is light and can stand in an emitter only"],
    ),
    "attribute of a spectrum": (
        diffuse('<spectrum type="blackbody" name="reflectance"><float name="temprature" value="5000"/></spectrum>'),
        ["blackbody has no attribute 'temprature'; did you mean 'temperature'? known: temperature, wavelength_max, wave"],
    ),
    "regular spectrum without a range": (
        diffuse('<spectrum type="regular" name="reflectance"><string name="values" value="0.1, 0.2"/></spectrum>'),
        ["needs either wavelength_min, wavelength_max and values, or value"],
    ),
    "text in a spectrum": (
        diffuse('<spectrum type="irregular" name="reflectance"><string name="values" value="0.1, a"/>'
                '<string name="wavelengths" value="400, 500"/></spectrum>'),
        ["values must be made of numbers, could not convert string to float: 'a'"],
    ),
    "daylight on a texture": (
        diffuse('<spectrum type="d65" name="reflectance"><texture type="bitmap" name="color"/></spectrum>'),
        ["d65 does not take an object called 'color'; 'color' is a plain value", "put the texture itself into this place"],
    ),
    "string for an integer": (
        '<sensor type="perspective"><film type="hdrfilm">\n<string name="width" value="abc"/></film></sensor>',
        ['line 3: <string name="width"> of <film type="hdrfilm">', "width must be an integer, got 'abc'"],
    ),
    "text in an integer": (
        '<integrator type="path"><integer name="max_depth" value="4.5"/></integrator>',
        ['<integer name="max_depth">', "must be an integer, got '4.5'"],
    ),
    "no boolean": (
        '<integrator type="path"><boolean name="hide_emitters" value="yes"/></integrator>',
        ["true or false, got 'yes'"],
    ),
    "number for a matrix": (shape('<float name="to_world" value="1"/>'), ["to_world must be a 4 x 4 matrix, got 1.0"]),
    "colour for a radius": (
        shape('<rgb name="radius" value="1"/>', "sphere"),
        ["radius must be a number, got [1.0, 1.0, 1.0]"],
    ),
    "negative radius": (
        shape('<float name="radius" value="-1"/>', "sphere"),
        ["line 2: <shape", "radius must be greater than 0"],
    ),
    "missing value": (shape('<float name="radius"/>', "sphere"), ['<float name="radius">', "'value' is missing"]),
    "missing name": (shape('<float value="1"/>', "sphere"), ["line 2: <float>", "'name' is missing"]),
    "missing type": ("<shape/>", ["line 2: <shape>", "'type' is missing"]),
    "unknown xml attribute": (
        '<bsdf type="diffuse" colour="red"/>',
        ["line 2: <bsdf", "unknown attribute 'colour'", "known: id"],
    ),
    "missing file name": (shape("", "obj"), ['line 2: <shape type="obj"', "obj needs 'filename'"]),
    "missing mesh": (
        shape('\n<string name="filename" value="gone.obj"/>', "obj"),
        ['line 3: <string name="filename"> of <shape', "'gone.obj' not found; looked in"],
    ),
    "missing texture": (
        diffuse('<texture type="bitmap" name="reflectance"><string name="filename" value="gone.png"/></texture>'),
        ['line 3: <string name="filename"> of <texture', "'gone.png' not found"],
    ),
    "empty mesh": (
        shape('<string name="filename" value="empty.obj"/>', "obj"),
        ["line 2: <shape", "empty.obj", "no faces"],
    ),
    "degenerate mesh": (
        shape('<string name="filename" value="line.obj"/>', "obj"),
        ["line 2: <shape", "line.obj", "degenerate"],
    ),
    "mesh that is not finite": (
        shape('<string name="filename" value="nan.obj"/>', "obj"),
        ["nan.obj, line 2", "expected a finite number, got 'nan'"],
    ),
    "damaged image": (
        diffuse('<texture type="bitmap" name="reflectance"><string name="filename" value="bad.exr"/></texture>'),
        ["line 3: <texture", "bad.exr: cannot be read as EXR"],
    ),
    "kind of image": (
        diffuse('<texture type="bitmap" name="reflectance"><string name="filename" value="line.obj"/></texture>'),
        ["line 3: <texture", "unknown kind of image '.obj'; supported: .exr, .png"],
    ),
    "reference to nothing": (
        diffuse("") + '<shape type="disk"><ref id="withe"/></shape>',
        ['line 3: <ref id="withe">', "no object has the id 'withe'", "did you mean 'white'"],
    ),
    "reference to the wrong kind": (
        shape('<ref id="lid"/>') + '<shape type="disk" id="lid"/>',
        ['<ref id="lid">', "'lid' is a shape, which cannot stand here", "supported: bsdf"],
    ),
    "reference in a circle": (
        '<bsdf type="twosided" id="a"><ref id="b"/></bsdf>\n<bsdf type="twosided" id="b"><ref id="a"/></bsdf>',
        ['<ref id="', "references in a circle"],
    ),
    "reference at the top": (
        '<bsdf type="diffuse" id="a"/><ref id="a"/>',
        ['line 2: <ref id="a">', "cannot stand directly in"],
    ),
    "duplicate id": (
        '<bsdf type="diffuse" id="a"/>\n<shape type="cube" id="a"/>',
        ['line 3: <shape type="cube" id="a">', "'a' is already taken by", "line 2: <bsdf"],
    ),
    "duplicate attribute": (
        shape('\n<float name="radius" value="1"/>\n<float name="radius" value="2"/>', "sphere"),
        ['line 4: <float name="radius">', "given twice", "first in line 3"],
    ),
    "two films": (
        '<sensor type="perspective"><film type="hdrfilm"/>\n<film type="hdrfilm"/></sensor>',
        ["line 3: <film", "perspective takes one film"],
    ),
    "two bsdfs": (
        shape('<bsdf type="diffuse"/>\n<bsdf type="diffuse"/>'),
        ["line 3: <bsdf", "rectangle takes one bsdf"],
    ),
    "two integrators": (
        '<integrator type="path"/>\n<integrator type="path"/>',
        ["line 3: <integrator", "already has an integrator"],
    ),
    "film in a shape": (
        shape('<film type="hdrfilm"/>'),
        ["line 2: <film", "a film cannot stand here", "supported: bsdf, emitter"],
    ),
    "one lamp on two shapes": (
        '<emitter type="area" id="lamp"/>' + 2 * '<shape type="sphere"><ref id="lamp"/></shape>',
        ["line 1: <scene>", "have one emitter, `lamp`", "give each shape its own"],
    ),
    "emitter in a bsdf": (
        diffuse('\n<emitter type="area"/>'),
        ["line 4: <emitter", "diffuse does not take", "known: reflectance"],
    ),
    "texture without a name": (
        diffuse('<texture type="bitmap"/>'),
        ["<texture", "diffuse does not take", "known: reflectance"],
    ),
    "value in the scene": ('<float name="x" value="1"/>', ["line 2: <float", "<scene> takes no values"]),
    "element in a value": (
        shape('<float name="x" value="1"><bsdf type="diffuse"/></float>'),
        ["<bsdf", "inside <float>"],
    ),
    "unknown operation": (
        shape('<transform name="to_world"><shear x="1"/></transform>'),
        ["<shear>", "known: lookat, matrix"],
    ),
    "numbers of a matrix": (
        shape('<transform name="to_world"><matrix value="1 2 3"/></transform>'),
        ["<matrix>", "9 or 16", "got 3"],
    ),
    "singular matrix": (
        shape('<transform name="to_world"><scale x="0"/></transform>'),
        ["line 2: <shape", "to_world must be invertible"],
    ),
    "rotation about nothing": (
        shape('<transform name="to_world"><rotate angle="3"/></transform>'),
        ["<rotate>", "axis must not be zero"],
    ),
    "look at oneself": (
        shape('<transform name="to_world"><lookat origin="1,1,1" target="1,1,1"/></transform>'),
        ["<lookat>", "origin and target must differ"],
    ),
    "up along the view": (
        shape('<transform name="to_world"><lookat origin="0,0,1" target="0,0,0" up="0,0,1"/></transform>'),
        ["<lookat>", "up must not be parallel"],
    ),
    "undeclared variable": (
        shape('<float name="radius" value="$r"/>', "sphere"),
        ['<float name="radius">', "$r has no value", "<default"],
    ),
    "missing include": ('<include filename="gone.xml"/>', ["line 2: <include>", "'gone.xml' not found; looked in"]),
    "include in a circle": ('<include filename="scene.xml"/>', ["line 2: <include>", "'scene.xml' includes itself"]),
    "alias of nothing": ('<alias id="x" as="y"/>', ["line 2: <alias", "no object with the id 'x'"]),
    "field of view": (
        '<sensor type="perspective"><float name="fov" value="180"/></sensor>',
        ["line 2: <sensor", "fov must be between"],
    ),
    "endless number": (
        shape(f'<float name="radius" value="{"1" * 5000}"/>', "sphere"),
        ["<float", "value must be made of finite numbers", "1111..."],
    ),
    "number beyond float64": (shape('<float name="radius" value="1e999"/>', "sphere"), ["<float", "finite", "'1e999'"]),
    "integer of many digits": (
        f'<integrator type="path"><integer name="max_depth" value="{"9" * 5000}"/></integrator>',
        ["<integer", "value must be an integer, got '9999"],
    ),
    "integer beyond 32 bits": (
        '<integrator type="path"><integer name="max_depth" value="99999999999"/></integrator>',
        ["<integer", "must be between -2147483647 and 2147483647"],
    ),
    "digits of another script": (shape('<float name="radius" value="١"/>', "sphere"), ["<float", "finite numbers"]),
    "reserved id": (shape("").replace("wall", "type"), ["line 2: <shape", "the id 'type' is reserved; use another"]),
    "reserved type": ('<shape type="type"/>', ["line 2: <shape", "the shape type 'type' is not supported"]),
    "long id": (f'<material id="{"a" * 5000}"/>', ["aaaa...", "not supported"]),
    "long file name": (f'<include filename="{"a" * 5000}"/>', ["<include>", "not found; looked in"]),
    "rotation by infinity": (
        shape('<transform name="to_world"><rotate y="1" angle="1e999"/></transform>'),
        ["<rotate>", "angle must be made of finite numbers"],
    ),
    "crop outside": (
        '<sensor type="perspective"><film type="hdrfilm"><integer name="crop_width" value="9999"/></film></sensor>',
        ["line 2: <film", "crop window", "must lie inside"],
    ),
}


@pytest.mark.parametrize("case", XML)
def test_bad_xml_names_file_line_and_what_is_supported(tmp_path, case):
    body, fragments = XML[case]
    (tmp_path / "empty.obj").write_text("")
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    (tmp_path / "nan.obj").write_text(TRIANGLE_OBJ.replace("v 1 0 0", "v 1 nan 0"))
    (tmp_path / "bad.exr").write_bytes(b"v/1\x01")
    with pytest.raises(SceneError) as caught:
        load(write_scene(tmp_path, body))
    assert_contains(str(caught.value), [str(tmp_path / "scene.xml"), *fragments])


ENDLESS_LIST = []
ENDLESS_LIST.append(ENDLESS_LIST)
ENDLESS_DICT = {"type": "twosided"}
ENDLESS_DICT["inner"] = ENDLESS_DICT


def nested(depth):
    return {"type": "twosided", "inner": nested(depth - 1)} if depth else {"type": "diffuse"}


def doubled(depth):
    """A dict of few objects that stand for 2^depth."""
    inner = {"type": "diffuse"}
    for _ in range(depth):
        inner = {"type": "twosided", "a": inner, "b": inner}
    return inner


DISK = {"type": "disk"}
DICTS = {
    "no scene": (DISK, ['"type": "scene"', "'disk'"]),
    "no dict": ([DISK], ['"type": "scene"', "list"]),
    "unknown plugin": (
        scene_dict(wall={"type": "rectangel"}),
        ["wall", "'rectangel' is not supported", "did you mean 'rectangle'"],
    ),
    "unknown attribute": (scene_dict(ball={"type": "sphere", "radios": 1}), ["ball.radios", "did you mean 'radius'"]),
    "nested value": (
        scene_dict(light={"type": "disk", "emitter": {"type": "area", "radiance": "bright"}}),
        ["light.emitter.radiance", "a number, three numbers, a spectrum or a texture", "'bright'"],
    ),
    "nested range": (
        scene_dict(light={"type": "disk", "emitter": {"type": "area", "radiance": -1.0}}),
        ["light.emitter (type 'area')", "radiance must be at least 0, got -1"],
    ),
    "top level value": (scene_dict(size=3), ["size", "takes only objects", "got 3"]),
    "no type": (scene_dict(wall={"bsdf": {}}), ["wall", "takes only objects"]),
    "nested without type": (
        scene_dict(wall={"type": "disk", "bsdf": {"reflectance": 1}}),
        ["wall.bsdf", "must be a bsdf", "got {"],
    ),
    "matrix shape": (
        scene_dict(wall={"type": "disk", "to_world": np.eye(4)[:3]}),
        ["wall.to_world", "4 x 4 matrix, got ndarray of shape (3, 4)"],
    ),
    "matrix nan": (
        scene_dict(wall={"type": "disk", "to_world": torch.full((4, 4), torch.nan)}),
        ["wall.to_world", "finite"],
    ),
    "matrix not affine": (
        scene_dict(wall={"type": "disk", "to_world": np.ones((4, 4))}),
        ["wall.to_world", "last row 0, 0, 0, 1"],
    ),
    "point of two": (
        scene_dict(lamp={"type": "point", "position": [1, 2]}),
        ["lamp.position", "three numbers, got [1, 2]"],
    ),
    "infinite float": (scene_dict(ball={"type": "sphere", "radius": float("inf")}), ["ball.radius", "finite"]),
    "bool for int": (
        scene_dict(path={"type": "path", "max_depth": True}),
        ["path.max_depth", "must be an integer, got True"],
    ),
    "float for int": (
        scene_dict(path={"type": "path", "max_depth": 3.0}),
        ["path.max_depth", "must be an integer, got 3.0"],
    ),
    "int for bool": (
        scene_dict(path={"type": "path", "hide_emitters": 1}),
        ["path.hide_emitters", "must be true or false, got 1"],
    ),
    "missing file": (
        scene_dict(mesh={"type": "ply", "filename": "gone.ply"}),
        ["mesh.filename", "'gone.ply' not found; looked in"],
    ),
    "wrong place": (
        scene_dict(wall={"type": "disk", "film": {"type": "hdrfilm"}}),
        ["wall.film", "'hdrfilm' is a film", "bsdf, emitter"],
    ),
    "reference": (
        scene_dict(wall={"type": "disk", "bsdf": {"type": "ref", "id": "whit"}}, white={"type": "diffuse"}),
        ["wall.bsdf", "no object has the id 'whit'", "'white'"],
    ),
    "duplicate id": (
        scene_dict(a={"type": "diffuse", "id": "x"}, b={"type": "diffuse", "id": "x"}),
        ["b", "'x' is already taken by a"],
    ),
    "rgb": (
        scene_dict(white={"type": "diffuse", "reflectance": {"type": "rgb", "value": [1, 2]}}),
        ["white.reflectance", "three numbers"],
    ),
    "rgb entries": (
        scene_dict(white={"type": "diffuse", "reflectance": {"type": "rgb", "values": 1}}),
        ["white.reflectance", "type and value, got type, values"],
    ),
    "wavelengths": (
        scene_dict(white={"type": "diffuse", "reflectance": {"type": "spectrum", "value": [(400, 0.1, 700)]}}),
        ["white.reflectance", "a number, three numbers, a spectrum or a texture"],
    ),
    "bitmap values": (
        scene_dict(white={"type": "diffuse", "reflectance": {"type": "bitmap", "data": np.full((2, 2, 3), np.nan)}}),
        ["white.reflectance (type 'bitmap')", "data must be finite"],
    ),
    "key": ({**scene_dict(), 3: DISK}, ["scene dict", "keys must be strings, got 3"]),
    "id": (scene_dict(a={"type": "disk", "id": [1]}), ["a", "an id must be a string, got [1]"]),
    "empty name": (scene_dict(**{"": DISK}), ["an object of the scene has an empty name"]),
    "reference without an id": (
        scene_dict(a={"type": "disk", "bsdf": {"type": "ref"}}),
        ["a.bsdf", "a reference has the entries type and id, a string, got id None"],
    ),
    "reference with more": (
        scene_dict(w={"type": "diffuse"}, a={"type": "disk", "bsdf": {"type": "ref", "id": "w", "scale": 2}}),
        ["a.bsdf", "a reference has the entries type and id", "scale"],
    ),
    "a network as an object": (scene_dict(net=torch.nn.Linear(1, 1)), ["net", "a Linear cannot stand here", "shape, bsdf"]),
    "complex numbers": (
        scene_dict(ball={"type": "sphere", "center": np.array([1j, 0, 0])}),
        ["ball.center", "three numbers"],
    ),
    "complex texels": (
        scene_dict(w={"type": "diffuse", "reflectance": {"type": "bitmap", "data": np.full((2, 2, 3), 0.5 + 1j)}}),
        ["w.reflectance.data", "an array of numbers, got ndarray of shape (2, 2, 3)"],
    ),
    "complex tensor": (
        scene_dict(w={"type": "diffuse", "reflectance": {"type": "bitmap", "data": torch.ones(2, 2, 3) * 1j}}),
        ["w.reflectance.data", "an array of numbers, got Tensor of shape (2, 2, 3)"],
    ),
    "text for numbers": (
        scene_dict(ball={"type": "sphere", "center": ["1", "2", "3"]}),
        ["ball.center", "three numbers, got ['1', '2', '3']"],
    ),
    "truth for a colour": (scene_dict(w={"type": "diffuse", "reflectance": True}), ["w.reflectance", "a number, three"]),
    "a list that contains itself": (
        scene_dict(ball={"type": "sphere", "center": ENDLESS_LIST}),
        ["ball.center", "three numbers, got [[...]]"],
    ),
    "huge integer": (
        scene_dict(path={"type": "path", "max_depth": 10**400}),
        ["path.max_depth", "must be between -2147483647 and 2147483647, got int 1000"],
    ),
    "integer of more digits than Python prints": (
        scene_dict(path={"type": "path", "max_depth": 10**5000}),
        ["path.max_depth", "must be between", "got an int of very many digits"],
    ),
    "huge radius": (scene_dict(ball={"type": "sphere", "radius": 10**400}), ["ball.radius", "must be finite"]),
    "beyond single precision": (
        scene_dict(wall={"type": "disk", "to_world": np.diag([1e39, 1, 1, 1])}),
        ["wall", "to_world must be finite", "float32"],
    ),
    "texels beyond single precision": (
        scene_dict(w={"type": "diffuse", "reflectance": {"type": "bitmap", "data": np.full((2, 2, 3), 1e300)}}),
        ["w.reflectance (type 'bitmap')", "data must be finite", "float32"],
    ),
    "faces with fractions": (
        scene_dict(m={"type": "mesh", "vertex_positions": np.eye(3), "faces": [[0, 1, 1.5]]}),
        ["m (type 'mesh')", "faces must be indices of vertices, integers"],
    ),
    "normals of length 0": (
        scene_dict(m={"type": "mesh", "vertex_positions": np.eye(3), "faces": [[0, 1, 2]], "vertex_normals": np.eye(3) * 0}),
        ["m (type 'mesh')", "vertex_normals must not be zero"],
    ),
    "file name with a zero byte": (scene_dict(m={"type": "obj", "filename": "a\0b.obj"}), ["m.filename", "not found"]),
    "long file name": (scene_dict(m={"type": "obj", "filename": "a" * 5000}), ["m.filename", "str 'aaaa", "not found"]),
    "folder for a file": (scene_dict(m={"type": "obj", "filename": "/"}), ["m.filename", "'/' not found"]),
    "a dict that contains itself": (
        scene_dict(a=ENDLESS_DICT),
        ["a.inner.inner", "nested more than 100 deep; does a dict contain itself?"],
    ),
    "deep nesting": (scene_dict(a=nested(150)), ["a.inner.inner", "nested more than 100 deep"]),
    "a dict in many places": (
        scene_dict(a=doubled(40)),
        ["the scene has more than 1000 objects", "give it an id and refer to it"],
    ),
    "chain of references": (
        scene_dict(last={"type": "diffuse"}, **{f"b{i}": {"type": "twosided", "inner": {
            "type": "ref", "id": f"b{i + 1}" if i < 200 else "last"}} for i in range(201)}),
        ["nested more than 100 deep, references followed"],
    ),
}


@pytest.mark.parametrize("case", DICTS)
def test_bad_dicts_name_the_path_of_keys(case, monkeypatch):
    description, fragments = DICTS[case]
    monkeypatch.setattr("torch_radbp.io.build.MAX_OBJECTS", 1000)
    with pytest.raises(SceneError) as caught:
        load_dict(description)
    assert_contains(str(caught.value), fragments)


FILES = {
    "no version": ("<scene/>", ["line 1: <scene>", "'version' is missing", "3.0.0"]),
    "newer version": (scene_text("", version="4.1.0"), ["line 1: <scene>", "newer than what is supported"]),
    "name of an old version": (
        scene_text('<integrator type="path"><float name="shutterOpen" value="1"/></integrator>', version="0.6.0"),
        ['line 2: <float name="shutter_open">', "path has no attribute 'shutter_open'"]),
    "odd version": (scene_text("", version="three"), ["line 1: <scene>", "must read like", "'three'"]),
    "another root": ('<bsdf version="3.0.0" type="diffuse"/>', ["line 1: <bsdf", "must be <scene"]),
    "cut off": (scene_text("")[:-9], ["line 3", "not well-formed XML"]),
    "doctype": ("<!DOCTYPE scene>" + scene_text(""), ["line 1", "not allowed"]),
    "no sensor": (scene_text(LAMP, complete=False), ["line 1: <scene>", "no sensor", "perspective"]),
    "no emitter": (scene_text(SENSOR, complete=False), ["line 1: <scene>", "no emitter", "constant,", "envmap, point"]),
}


@pytest.mark.parametrize("case", FILES)
def test_bad_files_are_named(tmp_path, case):
    text, fragments = FILES[case]
    (tmp_path / "scene.xml").write_text(text)
    with pytest.raises(SceneError) as caught:
        load(tmp_path / "scene.xml")
    assert_contains(str(caught.value), [str(tmp_path / "scene.xml"), *fragments])


def test_errors_inside_an_included_file_name_that_file(tmp_path):
    write_scene(tmp_path, "\n" + shape("", "rectangel"), name="part.xml", complete=False)
    with pytest.raises(SceneError, match=r"part\.xml, line 3: <shape"):
        load(write_scene(tmp_path, '<include filename="part.xml"/>'))


def test_variables_that_nothing_uses_are_refused(tmp_path):
    path = write_scene(tmp_path, '<default name="spp" value="4"/><bsdf type="diffuse" id="$spp"/>')
    with pytest.raises(SceneError, match=r"'ssp' is not used.*did you mean 'spp'"):
        load(path, ssp=64)


@pytest.mark.parametrize("name, message", [("gone.xml", "file not found"), ("scene.blend", r"supported: \.xml")])
def test_scenes_that_are_not_there_are_named(tmp_path, name, message):
    with pytest.raises(SceneError, match=f"{name}: .*{message}"):
        load(tmp_path / name)


def assert_contains(message, fragments):
    position = 0
    for fragment in fragments:
        found = message.find(fragment, position)
        assert found >= 0, f"{fragment!r} is not in order in: {message}"
        position = found
    assert "\n" not in message


def test_a_picture_with_values_that_do_not_fit_its_place_is_named(tmp_path):
    save_image(tmp_path / "holes.exr", torch.full((3, 2, 2), 1.5))
    picture = {"type": "bitmap", "filename": str(tmp_path / "holes.exr")}
    with pytest.raises(SceneError) as caught:
        load_dict(scene_dict(leaf={"type": "mask", "opacity": picture, "green": {"type": "diffuse"}}))
    assert_contains(str(caught.value), ["leaf (type 'mask')", "opacity, read from", "holes.exr,", "[0, 1], got 1.5"])
