"""Who is told that silhouettes are missing from a derivative: those who move some that the camera sees, once, by name."""

import warnings
from itertools import product

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad
from torch.func import functional_call

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.scenes import cornell, diffuse, load, look_at, rectangle, rgb, sensor, texels
from tests.scenes.meshes import icosphere
from torch_radbp.boundary.curve.edges import edges_of
from torch_radbp.boundary.terms import jump_watch
from torch_radbp.boundary.terms.jump_watch import SilhouetteWarning
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.shape.welding import cells_of, weld_size, welded

SKY = {"type": "constant", "radiance": rgb(0.5, 0.6, 0.7)}
PICTURE = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels(4, 4)}}
CUBE = {"type": "cube", "to_world": translate((0.1, 0.2, 0)) @ rotate((1, 2, 0.5), 40) @ scale((0.4, 0.4, 0.4)),
        "bsdf": diffuse(0.5)}


def bumpy_plane(half: float, divisions: int = 12) -> dict:
    """A square of many triangles with every third triangle's vertices of its own, slightly wavy, each second one turned."""
    x, y = np.meshgrid(np.linspace(-half, half, divisions + 1), np.linspace(-half, half, divisions + 1))
    vertices = np.stack([x, y, 0.02 * np.sin(3 * x + 2 * y)], -1).reshape(-1, 3)
    corner = (np.arange(divisions)[:, None] * (divisions + 1) + np.arange(divisions)).reshape(-1)
    faces = np.concatenate([np.stack([corner, corner + 1, corner + divisions + 2], 1),
                            np.stack([corner, corner + divisions + 2, corner + divisions + 1], 1)])
    faces[::2] = faces[::2, ::-1]
    own = vertices[faces[::3]].reshape(-1, 3)
    faces[::3] = len(vertices) + np.arange(len(own)).reshape(-1, 3)
    return {"type": "mesh", "vertex_positions": torch.tensor(np.concatenate([vertices, own])), "bsdf": PICTURE,
            "faces": torch.tensor(faces)}


def warnings_of(scene: rb.Scene, *names: str, calls: int = 1, **settings) -> list[str]:
    """What the renderer says when derivatives of parameters are asked for."""
    for name in names:
        scene.get_parameter(name).requires_grad_()
    renderer = rb.Renderer(scene, spp=1, compile=False, max_depth=2, caster="embree", terms=["interior"], **settings)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for seed in range(calls):
            renderer(seed=seed)
    caught = [warning for warning in caught if issubclass(warning.category, SilhouetteWarning)]
    assert all(warning.filename == __file__ for warning in caught)
    return [str(warning.message) for warning in caught]


def scene_of(size: int = 4, view: dict | None = None, **shapes) -> rb.Scene:
    return load(camera=view or sensor(size), sky=SKY, **shapes)


@pytest.mark.parametrize("name", ["plane.to_world", "camera.to_world", "camera.x_fov", "camera.principal_point_offset_x"])
def test_a_textured_plane_that_fills_the_view_gives_no_warning(name):
    assert warnings_of(scene_of(plane=rectangle((0, 0, 0), 3, (1, 1, 0), 10, bsdf=PICTURE)), name) == []


@pytest.mark.parametrize("name", ["plane.vertex_positions", "camera.to_world"])
def test_edges_inside_of_a_surface_are_none_even_where_vertices_are_double_and_triangles_turned(name):
    scene = scene_of(plane=bumpy_plane(3.0))
    assert warnings_of(scene, name) == []
    assert warnings_of(scene_of(plane=bumpy_plane(0.8)), name)  # its rim is in view


@pytest.mark.parametrize("name", ["box.vertex_positions", "camera.to_world", "camera.x_fov",
                                  "camera.principal_point_offset_y"])
def test_a_cube_in_view_is_named(name):
    message, = warnings_of(scene_of(box=CUBE), name)
    assert f"`{name}`" in message and "6 edges" in message  # three of its faces are seen, whose outline is a hexagon


def test_the_rim_of_a_plane_counts():
    message, = warnings_of(scene_of(plane=rectangle((0, 0, 0), 0.5, bsdf=PICTURE)), "plane.to_world")
    assert "4 edges" in message


def test_the_outline_of_a_sphere_counts_and_its_inside_does_not():
    assert warnings_of(scene_of(ball={"type": "sphere", "radius": 0.7}), "ball.to_world")
    near = sensor(4, (0.3, 0.2, 1.1), (0.1, 0, 0), 30)
    assert warnings_of(scene_of(view=near, ball={"type": "sphere"}), "ball.to_world", "camera.to_world") == []
    within = sensor(4, (0.1, 0.2, 0.3), (1, 0.5, 0))
    assert warnings_of(scene_of(view=within, ball={"type": "sphere"}), "ball.to_world") == []


def test_inside_of_a_room_the_camera_moves_no_silhouettes_but_those_of_what_stands_in_it():
    inside = sensor(4, (0.1, -0.2, 0.3), (0.4, -0.5, -1), 70)
    assert warnings_of(scene_of(view=inside, room={"type": "cube", "flip_normals": True}), "camera.to_world") == []
    walls = {f"wall_{k}": rectangle(np.eye(3)[k // 2] * (-1) ** k, 1, ((0, 1, 0), (1, 0, 0), (1, 0, 0))[k // 2],
                                    (90, 90, 0)[k // 2]) for k in range(6)}  # some normals to the outside
    assert warnings_of(scene_of(view=inside, **walls), "camera.to_world") == []
    small = {**CUBE, "to_world": translate((0.3, -0.4, -0.6)) @ scale((0.1, 0.1, 0.1))}
    assert warnings_of(scene_of(view=inside, **walls, box=small), "camera.to_world")
    # A wall that moves alone leaves its neighbours.
    assert warnings_of(scene_of(view=inside, **walls), "wall_5.to_world")


def test_what_moves_out_of_view_or_moves_nothing_gives_no_warning():
    scene = scene_of(box=CUBE, plane=rectangle((0, 0, -1), 9, bsdf=PICTURE),
                     behind=rectangle((0, 0, 6), 0.5), aside={**CUBE, "to_world": translate((9, 0, 0))})
    found = warnings_of(scene, "plane.to_world", "behind.to_world", "aside.vertex_positions", "box.vertex_normals",
                        "plane.bsdf.reflectance.data", "box.bsdf.reflectance.value", "sky.radiance.value")
    assert [message for message in found if "outlines" in message] == []


FLOOR = rectangle((0, 0, -1), 9, bsdf=PICTURE)
POINT = {"type": "point", "position": [0.5, 0.4, 2.0], "intensity": rgb(9, 7, 5)}
ASIDE = {**CUBE, "to_world": translate((-2.2, 0.1, 1)) @ scale((0.2, 0.2, 0.2))}  # out of view
LIGHTS = {  # all of which cast a shadow of the cube `aside` into the view
    "point.position": {"type": "point", "position": [-4.4, 0.2, 3], "intensity": rgb(9, 7, 5)},
    "spot.to_world": {"type": "spot", "to_world": look_at((-4.4, 0.2, 3), (0, 0, -1), (0, 1, 0)), "cutoff_angle": 30},
    "directional.to_world": {"type": "directional", "direction": [1.1, -0.05, -1], "irradiance": rgb(3, 3, 3)},
    "area.to_world": {"type": "rectangle", "emitter": {"type": "area", "radiance": rgb(9, 7, 5)},
                      "to_world": look_at((-4.4, 0.2, 3), (0, 0, -1), (0, 1, 0)) @ scale((0.2, 0.2, 0.2))},
    # Their middle lies inside.
    "ball.to_world": {"type": "sphere", "to_world": translate((-4.4, 0.2, 3)) @ scale((0.2, 0.2, 0.2)),
                      "emitter": {"type": "area", "radiance": rgb(9, 7, 5)}},
    "mesh.vertex_positions": {"type": "mesh", "emitter": {"type": "area", "radiance": rgb(9, 7, 5)},
                              "faces": icosphere(1)[1],
                              "vertex_positions": 0.2 * icosphere(1)[0] + torch.tensor([-4.4, 0.2, 3])},
    "projector.to_world": {"type": "projector", "to_world": look_at((-4.4, 0.2, 3), (0, 0, -1), (0, 1, 0)), "fov": 50,
                           "irradiance": {"type": "bitmap", "data": texels(4, 4)}},
    "block.to_world": {"type": "cube", "to_world": translate((-4.4, 0.2, 3)) @ scale((0.2, 0.2, 0.2)),
                       "emitter": {"type": "area", "radiance": rgb(9, 7, 5)}}}


def shadows(scene: rb.Scene, *names: str) -> list[str]:
    """The warnings about shadows."""
    return [message for message in warnings_of(scene, *names) if "borders of shadows" in message]


@pytest.mark.parametrize("name", deep_but([name for name in LIGHTS if not name.startswith(("ball", "block"))], LIGHTS))
def test_shadows_that_fall_into_the_view_are_named_with_all_that_moves_them(name):
    def lit(**shapes) -> rb.Scene:
        return load(camera=sensor(4, fov=30), floor=FLOOR, **{name.split(".")[0]: LIGHTS[name]}, **shapes)

    assert shadows(lit(), name, "floor.to_world", "camera.to_world") == []
    for moving in (name, "aside.vertex_positions", "floor.to_world", "camera.to_world"):
        message, = warnings_of(lit(aside=ASIDE), moving)
        assert f"`{moving}`" in message and "borders of shadows" in message
    message, = warnings_of(lit(aside=ASIDE), name, "aside.vertex_positions", "aside.vertex_normals")
    assert "`aside.vertex_positions`" in message and f"`{name}`" in message
    assert warnings_of(lit(aside=ASIDE), "floor.bsdf.reflectance.data") == []
    # What lies elsewhere casts its shadow elsewhere.
    assert shadows(lit(aside={**CUBE, "to_world": translate((2.4, 0.1, 1)) @ scale((0.2, 0.2, 0.2))}), name,
                   "camera.to_world") == []


def test_no_shadow_is_cast_by_what_is_not_lit():
    below = {**CUBE, "to_world": translate((0.1, 0.2, -2)) @ scale((0.2, 0.2, 0.2))}
    lamp = {**rectangle((0, 0, 3), 0.3, (1, 0, 0), 180), "emitter": {"type": "area", "radiance": rgb(9, 7, 5)}}
    behind = {**CUBE, "to_world": translate((0.1, 0.2, 4)) @ scale((0.2, 0.2, 0.2))}
    view = sensor(4, (0.1, 0, 2))
    for shapes in ({"box": below, "point": POINT}, {"box": behind, "lamp": lamp}):
        scene = load(camera=view, floor=FLOOR, ceiling=rectangle((0, 0, 9), 9), **shapes)
        assert shadows(scene, "box.vertex_positions", "floor.to_world") == []
    assert shadows(load(camera=view, floor=FLOOR, point=POINT, box={**behind, "to_world": translate((0.1, 0.2, 1)) @ scale(
        (0.2, 0.2, 0.2))}), "point.position")


def test_shadows_of_what_has_silhouettes_in_view_are_not_named_again():
    message, = warnings_of(scene_of(box=CUBE, floor=FLOOR, point=POINT), "box.vertex_positions")
    assert "outlines" in message
    first, second = warnings_of(scene_of(box=CUBE, floor=FLOOR, point=POINT), "box.vertex_positions", "point.position")
    assert "`box.vertex_positions`" in first and "`point.position`" in second and "box" not in second


def test_a_camera_that_is_not_rendered_does_not_count():
    scene = load(first=sensor(4), second=sensor(4, (0, 0, 9)), sky=SKY, plane=rectangle((0, 0, 0), 2, bsdf=PICTURE))
    scene.get_parameter("second.to_world").requires_grad_()
    renderer = rb.Renderer(scene, spp=1, compile=False, max_depth=2, terms=["interior"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        renderer(sensors=[0])
    with pytest.warns(SilhouetteWarning, match="`second.to_world`"):
        renderer(sensors=[1])


def test_the_crop_window_is_what_is_seen():
    film = {"type": "hdrfilm", "width": 40, "height": 40, "crop_width": 6, "crop_height": 6, "crop_offset_x": 17,
            "crop_offset_y": 17, "rfilter": {"type": "box"}}
    assert warnings_of(scene_of(view=sensor(film=film), plane=rectangle((0, 0, 0), 0.5)), "plane.to_world") == []
    for offset in ("crop_offset_x", "crop_offset_y"):
        for place in (10, 24):
            assert warnings_of(scene_of(view=sensor(film=film | {offset: place}), plane=rectangle((0, 0, 0), 0.5)),
                               "plane.to_world"), (offset, place)


def test_a_renderer_warns_once_and_with_all_names():
    message, = warnings_of(cornell(size=2), "box.vertex_positions", "light.to_world", calls=3)
    assert "`box.vertex_positions` and `light.to_world`" in message


def test_without_gradients_there_is_no_warning_and_forward_mode_has_it_too():
    scene = scene_of(box=CUBE)
    scene.get_parameter("box.vertex_positions").requires_grad_()
    with torch.no_grad():
        assert warnings_of(scene) == []
    scene.requires_grad_(False)
    vertices = scene.get_parameter("box.vertex_positions")
    with pytest.warns(SilhouetteWarning, match="`box.vertex_positions`"):
        rb.jvp(scene, {"box.vertex_positions": torch.ones_like(vertices)}, spp=1, max_depth=2, terms=["interior"],
               compile=False)
    renderer = rb.Renderer(scene, spp=1, compile=False, max_depth=2, terms=["interior"])
    with pytest.warns(SilhouetteWarning, match="`box.vertex_positions`"), forward_ad.dual_level(), torch.no_grad():
        functional_call(renderer, {"scene.box.vertex_positions": forward_ad.make_dual(vertices, torch.ones_like(vertices))})


def test_vertices_in_one_place_are_one_and_a_cube_has_18_edges():
    cube = rb.load_dict({"type": "scene", "camera": sensor(2), "sky": SKY, "box": CUBE}).box
    edges = edges_of(cube.vertex_positions.detach(), cube.faces)
    size = weld_size(cube.vertex_positions.detach())
    assert len(torch.unique(welded(cells_of(cube.vertex_positions.detach(), size)))) == 8
    assert len(edges.a) == 18 and (edges.count == 2).all()
    noisy = cube.vertex_positions.detach() * (1 + 1e-7 * torch.randn(24, 3, generator=torch.Generator().manual_seed(0)))
    assert len(torch.unique(welded(cells_of(noisy, size)))) == 8


def glass(**attributes) -> rb.Scene:
    """A sheet of rough glass that fills the view, before a wall that does."""
    return load(camera=sensor(4), wall=rectangle((0, 0, -1), 40, bsdf=PICTURE), sky=SKY,
                sheet=rectangle((0, 0, 0), 40, bsdf={"type": "roughdielectric", "distribution": "ggx"} | attributes))


@pytest.mark.parametrize("name", ["sheet.to_world", "wall.to_world", "camera.to_world", "sheet.bsdf.eta"])
def test_the_jump_of_ggx_glass_is_warned_of_by_name(name):
    message, = warnings_of(glass(), name, calls=3, sampling="detached")
    assert message.startswith(f"derivatives with respect to `{name}` lack a part at the roughdielectric `sheet.bsdf`")
    assert "sampling='attached'" in message


def test_the_jump_is_warned_of_where_hybrid_sampling_does_not_follow_the_glass():
    blend = {"type": "blendbsdf", "weight": 0.5, "paint": {"type": "diffuse"}, "pane": {
        "type": "roughdielectric", "distribution": "ggx"}}
    scene = load(camera=sensor(4), wall=rectangle((0, 0, -1), 40, bsdf=PICTURE), sky=SKY,
                 sheet=rectangle((0, 0, 0), 40, bsdf=blend))
    message, = warnings_of(scene, "sheet.to_world", sampling="hybrid")
    assert "lack a part at the blendbsdf `sheet.bsdf`" in message


def test_without_a_jump_there_is_nothing_to_warn_of():
    assert not any("lack a part" in message for sampling in ("hybrid", "attached")
                   for message in warnings_of(glass(), "sheet.to_world", sampling=sampling))
    assert not warnings_of(glass(distribution="beckmann"), "sheet.to_world", sampling="detached")
    assert not warnings_of(glass(), "wall.bsdf.reflectance.data")
    assert not warnings_of(glass(), "sheet.bsdf.alpha.value", "wall.bsdf.reflectance.data", sampling="detached")


def film() -> rb.Scene:
    """A thin sheet that fills the view, before a wall that does."""
    bsdf = {"type": "principledthin", "spec_trans": 0.9, "anisotropic": 0.5, "roughness": 0.4}
    return load(camera=sensor(4), wall=rectangle((0, 0, -1), 40, bsdf=PICTURE), sky=SKY,
                sheet=rectangle((0, 0, 0), 40, bsdf=bsdf))


@pytest.mark.parametrize("name, sampling, instead", [
    ("sheet.to_world", "detached", "No sampling has"), ("camera.to_world", "hybrid", "No sampling has"),
    ("sheet.to_world", "attached", "Use sampling='hybrid'"),
    ("sheet.bsdf.anisotropic.value", "attached", "Use sampling='hybrid'"),
    ("sheet.bsdf.roughness.value", "attached", "Use sampling='hybrid'")])
def test_the_jump_of_thin_sheets_is_warned_of_with_every_sampling(name, sampling, instead):
    message, = (message for message in warnings_of(film(), name, sampling=sampling) if "lack a part" in message)
    assert f"`{name.removesuffix('.value')}` lack a part at the principledthin `sheet.bsdf`" in message
    assert instead in message


def test_what_turns_no_directions_of_a_thin_sheet_is_not_warned_of():
    for name in ("sheet.bsdf.anisotropic.value", "sheet.bsdf.roughness.value"):
        assert not warnings_of(film(), name)
    assert not warnings_of(film(), "sheet.bsdf.spec_trans.value", sampling="attached")


METAL = {"type": "roughconductor", "alpha_u": 0.2, "alpha_v": 0.3}


@pytest.mark.parametrize("name, named", [
    ("plate.bsdf.brdf_0.alpha_v.value", "plate.bsdf.brdf_0.alpha_v"), ("box.vertex_normals", "box.vertex_normals"),
    ("plate.bsdf.brdf_0.eta.value", None), ("plate.bsdf.brdf_0.specular_reflectance.value", None)])
def test_attached_directions_that_slide_over_edges_are_warned_of_by_name(name, named):
    def scene() -> rb.Scene:
        return scene_of(box=CUBE, plate=rectangle((0, 0, -1), 9, bsdf={"type": "twosided", "bsdf": METAL}),
                        pane=rectangle((0, 0, 1), 9, bsdf={"type": "diffuse"}))

    assert not warnings_of(scene(), name)
    messages = warnings_of(scene(), name, calls=2, sampling="attached")
    assert len(messages) == (named is not None)
    assert all(f"derivatives with respect to `{named}` lack the contribution of edges" in message for message in messages)
    assert all("With sampling='hybrid'" in message for message in messages)


OF_GLASS = "pane.bsdf.eta", "box.vertex_normals", "pane.to_world", "near.x_fov"


@pytest.mark.parametrize("kind, name", [
    *product(["dielectric"], OF_GLASS), ("roughdielectric", "pane.bsdf.eta"),
    *(deep("roughdielectric", name) for name in OF_GLASS[1:])])
def test_so_are_those_that_follow_glass(kind, name):
    glass = {"type": "ref", "id": "glass"} if name.startswith("box") else {"type": kind}

    def scene() -> rb.Scene:
        return load(near=sensor(4, (0, 0, 3.5), fov=2), sky=SKY, glass={"type": kind},
                    box={**CUBE, "bsdf": glass}, pane=rectangle((0, 0, 1), 9, bsdf=glass))

    assert not warnings_of(scene(), name, sampling="detached")
    for sampling in ("hybrid", "attached"):
        message, = warnings_of(scene(), name, sampling=sampling)
        assert f"derivatives with respect to `{name}` lack the contribution of edges" in message
        assert "sampling=" not in message


def test_edges_that_directions_slide_over_are_looked_for_once_for_each_parameter(monkeypatch):
    looked, look = [], jump_watch.missing_silhouettes
    monkeypatch.setattr(jump_watch, "missing_silhouettes", lambda rendering: looked.append(rendering) or look(rendering))
    scene = load(camera=sensor(4), sky=SKY, mirror={**CUBE, "bsdf": {"type": "conductor"}})
    scene.get_parameter("camera.to_world").requires_grad_()
    renderer = rb.Renderer(scene, spp=1, max_depth=3, terms=["interior"])
    with pytest.warns(SilhouetteWarning, match="`camera.to_world` lack the contribution of silhouettes"):
        renderer(seed=1)
    searches = len(looked)
    renderer(seed=2)
    assert 0 < searches == len(looked)


def test_directions_from_a_single_plane_meet_no_edges():
    scene = scene_of(plate=rectangle((0, 0, 0), 9, (1, 2, 0), 20, bsdf=METAL))
    assert not warnings_of(scene, "plate.bsdf.alpha_u.value", sampling="attached")


PLATE = rectangle((0, 0, 1), 0.4, bsdf=diffuse(0.5))
ENVMAP = {"type": "envmap", "bitmap": texels(4, 8)}


def soft_shadows(scene: rb.Scene, *names: str) -> list[str]:
    """The warnings about shadows, where edges in view are computed."""
    for name in names:
        scene.get_parameter(name).requires_grad_()
    renderer = rb.Renderer(scene, spp=1, compile=False, max_depth=2, caster="embree", terms=["interior", "primary"])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for seed in range(2):
            renderer(seed=seed)
    return [str(warning.message) for warning in caught if "borders of shadows" in str(warning.message)]


@pytest.mark.parametrize("sky", [SKY, ENVMAP, {"type": "sunsky", "sun_direction": [0.3, 0.2, 1.0]}],
                         ids=["constant", "envmap", "sunsky"])
@pytest.mark.parametrize("name", ["plate.to_world", "floor.to_world", "camera.to_world"])
def test_what_hides_a_part_of_the_sky_is_warned_of_once_by_name(name, sky):
    message, = soft_shadows(load(camera=sensor(4), sky=sky, floor=FLOOR, plate=PLATE), name)
    assert f"`{name}`" in message and "soft" in message


@pytest.mark.parametrize("name", ["plate.to_world", "aside.to_world", "point.position", "camera.to_world"])
def test_shadows_that_are_computed_are_not_warned_of(name):
    for sampling in ("hybrid", "attached"):
        scene = load(camera=sensor(4), floor=FLOOR, plate=PLATE, aside=ASIDE, sky=SKY, point=POINT)
        scene.get_parameter(name).requires_grad_()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            rb.Renderer(scene, spp=1, compile=False, max_depth=2, sampling=sampling)(seed=1)


@pytest.mark.parametrize("bsdf, light, max_depth, warned", [
    ({"type": "conductor"}, POINT, 4, "seen by surfaces, not by the camera, in `mirror.bsdf`"),
    ({"type": "conductor"}, POINT, 3, None), ({"type": "conductor"}, SKY, 4, None),
    ({"type": "roughdielectric"}, POINT, 3, None)])
def test_sharp_shadows_seen_in_a_mirror_are_warned_of_where_they_are_not_computed(bsdf, light, max_depth, warned):
    """Those that the camera sees in ideal mirrors are, those in rough glass, and soft ones; what paths do not reach is not
    missed."""
    scene = load(camera=sensor(4), floor=FLOOR, plate=PLATE, mirror={**ASIDE, "bsdf": bsdf}, light=light)
    scene.get_parameter("plate.to_world").requires_grad_()
    with pytest.warns(SilhouetteWarning, match=f"`light`, a light without.*{warned}") if warned else (
            warnings.catch_warnings()):
        warnings.simplefilter("always" if warned else "error", SilhouetteWarning)
        rb.Renderer(scene, spp=1, compile=False, max_depth=max_depth, light_paths="camera")(seed=1)


@pytest.mark.parametrize("kind, others, said", [
    ("dielectric", {}, None), ("conductor", {}, None), ("roughdielectric", {}, None),
    ("dielectric", {"wall": rectangle((0, 0, -4), 9, bsdf=diffuse(0.5))}, "edges seen by surfaces, not by the camera, by")])
def test_edges_that_cameras_see_in_ideal_mirrors_and_glass_are_not_warned_of(kind, others, said):
    scene = load(near=sensor(4, (0, 0, 3.5), fov=2), sky=SKY, box={**CUBE, "bsdf": {"type": kind}}, **others)
    scene.get_parameter("box.to_world").requires_grad_()
    with pytest.warns(SilhouetteWarning, match=said) if said else warnings.catch_warnings():
        warnings.simplefilter("always" if said else "error", SilhouetteWarning)
        rb.Renderer(scene, spp=1, compile=False, max_depth=4)(seed=1)


def test_what_is_hidden_of_a_sky_that_turns_stays_what_it_was():
    assert soft_shadows(load(camera=sensor(4), sky=ENVMAP, floor=FLOOR, plate=PLATE), "sky.to_world") == []


@pytest.mark.parametrize("shape", [CUBE, {"type": "sphere", "radius": 0.7}, rectangle((0, 0, 0), 0.5)])
def test_a_convex_shape_alone_hides_no_sky_from_itself(shape):
    assert soft_shadows(scene_of(thing=shape), "thing.to_world", "camera.to_world") == []


def test_no_sky_is_hidden_where_none_is_seen_or_nothing_moves():
    room = {"type": "cube", "flip_normals": True, "to_world": scale((9, 9, 9)), "bsdf": diffuse(0.5)}
    assert soft_shadows(scene_of(room=room, floor=FLOOR, plate=PLATE), "plate.to_world", "camera.to_world") == []
    assert soft_shadows(scene_of(floor=FLOOR, plate=PLATE), "floor.bsdf.reflectance.data", "sky.radiance.value") == []
    mirror = FLOOR | {"bsdf": {"type": "conductor"}}
    assert soft_shadows(scene_of(floor=mirror, plate=PLATE), "plate.to_world") == []


SUN = {"type": "directional", "direction": [0.0, 0, -1], "irradiance": rgb(3, 3, 3)}
BALL = {"type": "sphere", "radius": 0.4, "bsdf": {"type": "dielectric"}}


def caustics(max_depth: int = 4, light_paths: str = "camera", **objects) -> list[str]:
    """The warnings about light that paths from the camera do not find."""
    settings = {"max_depth": max_depth, "light_paths": light_paths}
    renderer = rb.Renderer(load(camera=sensor(4), **objects), spp=1, compile=False, **settings)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for seed in range(2):
            renderer(seed=seed)
    return [str(warning.message) for warning in caught if "caustics" in str(warning.message)]


@pytest.mark.parametrize("lamp", [POINT, SUN], ids=["point", "directional"])
@pytest.mark.parametrize("kind", ["dielectric", "conductor"])
def test_caustics_of_a_light_without_extent_are_said_to_be_missing(kind, lamp):
    aside = SUN | {"direction": [1.0, 0, -1]} if lamp is SUN else lamp | {"position": [-2.0, 0, 0.5]}
    message, = caustics(lamp=aside, floor=FLOOR, ball=BALL | {"bsdf": {"type": kind}})
    assert "`lamp`" in message and "`ball`" in message and "area emitter" in message and "lacks them" in message
    message, = caustics(lamp=aside, floor=FLOOR, ball=BALL | {"bsdf": {"type": kind}}, light_paths="auto")
    assert "`lamp`" in message and "`ball`" in message and "begin at the lamps" in message
    assert caustics(lamp=aside, floor=FLOOR, ball=BALL | {"bsdf": {"type": kind}}, light_paths="caustics") == []


def test_no_caustics_are_missing_where_paths_find_them_or_there_are_none():
    area = {**rectangle((0, 0, 3), 0.3, (1, 0, 0), 180), "emitter": {"type": "area", "radiance": rgb(9, 7, 5)}}
    assert caustics(lamp=area, floor=FLOOR, ball=BALL) == caustics(sky=SKY, floor=FLOOR, ball=BALL) == []
    assert caustics(lamp=POINT, floor=FLOOR, ball=BALL | {"bsdf": {"type": "roughdielectric"}}) == []
    assert caustics(lamp=POINT, floor=FLOOR, ball=BALL, max_depth=2) == []  # direct light alone
    assert caustics(lamp=POINT, floor=FLOOR | {"bsdf": {"type": "conductor"}}) == []  # nothing shows it
    hidden = BALL | {"to_world": translate((0, 0, -3))}
    assert caustics(lamp=POINT, floor=FLOOR, ball=hidden) == []


def far_off(far: float, name: str, dtype: torch.dtype) -> list[str]:
    """What a renderer with all terms says of edges so far from the origin, in two calls."""
    at = np.array((far, -0.5 * far, 0))
    scene = load(dtype, camera=sensor(4, at + (0, 0, 3.5), at), sky=SKY, box=CUBE | {"to_world": translate(at)})
    scene.get_parameter(name).requires_grad_()
    renderer = rb.Renderer(scene, spp=1, compile=False, max_depth=1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for seed in range(2):
            renderer(seed=seed)
    return [str(warning.message) for warning in caught if "origin" in str(warning.message)]


@pytest.mark.parametrize("name", ["box.to_world", "camera.to_world", "box.bsdf.reflectance.value"])
@pytest.mark.parametrize("dtype, far", [(torch.float32, 2e4), (torch.float64, 2e5)])
def test_edges_so_far_from_the_origin_that_rays_miss_them_are_named(dtype, far, name):
    assert far_off(0.1 * far, name, dtype) == []
    found = far_off(far, name, dtype)
    assert [f"`{name}`" in message and "1e+0" in message for message in found] == [True] * ("to_world" in name)
