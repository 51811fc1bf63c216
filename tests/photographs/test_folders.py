"""Where photographs lie: data sets that list more than there is, and folders that are one off."""

import json
import warnings

import pytest
import torch
from PIL import Image

import torch_radbp as rb
from tests.photographs.nerf_folder import TO_OPENGL
from torch_radbp.plugin import SceneError

LISTED, PRESENT = 67, 50


def picture(path, level=90, width=8, height=6):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (width, height), (level, level, level)).save(path)


def frames_of(*names):
    pose = (rb.look_at((0, 1, 3), (0, 0, 0), (0, 1, 0)) @ TO_OPENGL).tolist()
    return [{"file_path": name, "sharpness": 23.2, "transform_matrix": pose} for name in names]


def write(folder, *names, **entries):
    """transforms.json as instant-ngp's scripts write it."""
    document = {"camera_angle_x": 0.75, "camera_angle_y": 0.58, "fl_x": 10.2, "fl_y": 10.1, "k1": 0.008, "k2": -0.01,
                "p1": 0.0002, "p2": -0.0001, "cx": 4.1, "cy": 3.05, "w": 8.0, "h": 6.0, "aabb_scale": 4,
                "frames": frames_of(*names)} | entries
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder / "transforms.json"


def colmap(folder, *names):
    (folder / "cameras.txt").write_text("1 SIMPLE_PINHOLE 8 6 7 4 3\n")
    (folder / "images.txt").write_text("".join(f"{n + 1} 1 0 0 0 0 0 {n} 1 {name}\n\n" for n, name in enumerate(names)))
    return folder


def silently(call):
    """What a call returns that must not warn."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return call()


@pytest.fixture
def fox(tmp_path):
    """The layout of instant-ngp's capture of a fox: 67 frames listed, 50 images there, floats as sizes."""
    names = [f"images/{n:04d}.jpg" for n in range(1, LISTED + 1)]
    for n in range(PRESENT):
        picture(tmp_path / names[n + (n >= 20) * (LISTED - PRESENT)], 2 * n)
    return write(tmp_path, *names)


def test_a_capture_that_lists_more_frames_than_it_has_images_is_read_without_them(fox):
    with pytest.warns(UserWarning) as caught:
        photographs = rb.Photographs.from_nerf(fox)
    assert [str(warning.message) for warning in caught] == [
        f"images/0021.jpg, images/0022.jpg, images/0023.jpg and 14 more: left out of {fox}: the image is not there "
        "(missing=\"error\" insists on all)"]
    assert len(photographs) == len(photographs.cameras) == PRESENT
    assert photographs.names[19:21] == ["images/0020_jpg", "images/0038_jpg"]
    levels = [float(each.image.mean()) for each in photographs]
    assert levels == sorted(levels) and levels[-1] > 0.1  # each camera has its own image
    scene = rb.load_dict({"type": "scene", **photographs.cameras, "sky": {"type": "constant"},
                          "ball": {"type": "sphere"}})
    assert rb.render(scene, spp=1, max_depth=1, sensors=photographs[30].sensors).shape == (1, 3, 6, 8)


def test_whoever_insists_gets_an_error(fox):
    with pytest.raises(FileNotFoundError, match="0021.jpg: file not found, the image 'images/0021.jpg' of the data set"):
        rb.Photographs.from_nerf(fox, missing="error")
    with pytest.raises(SceneError, match="and 14 more: left out of .*transforms.json: the image is not there"):
        rb.Photographs.from_nerf(fox, strict=True)
    with pytest.raises(ValueError, match="missing must be 'skip' or 'error', got None"):
        rb.Photographs.from_nerf(fox, missing=None)


def test_names_without_extension_are_completed(tmp_path):
    """As the Blender scenes have them; and view.jpg.png is no image of view.jpg, but its mask."""
    picture(tmp_path / "train" / "r_0.png")
    picture(tmp_path / "train" / "r_1.webp")
    picture(tmp_path / "train" / "r_3.jpg.png")
    with pytest.warns(UserWarning, match="^train/r_2, train/r_3.jpg: left out of .*transforms.json"):
        photographs = rb.Photographs.from_nerf(write(tmp_path, "./train/r_0", "train/r_1", "train/r_2", "train/r_3.jpg"))
    assert photographs.names == ["train/r_0", "train/r_1"]


@pytest.mark.parametrize("images", [None, "pictures"])
def test_if_no_image_is_there_the_folder_that_was_looked_in_is_named(tmp_path, images):
    path = write(tmp_path, "images/a.jpg", "images/b.jpg")
    looked = tmp_path if images is None else tmp_path / images
    with pytest.raises(FileNotFoundError, match=f"json: none of its 2 images is there; looked for .*a.jpg in {looked}"):
        rb.Photographs.from_nerf(path, images=images and tmp_path / images)
    with pytest.raises(FileNotFoundError, match=f"none of its 2 images is there; looked for images/a.jpg in {looked}"):
        rb.Photographs.from_colmap(colmap(tmp_path, "images/a.jpg", "images/b.jpg"), looked)


@pytest.mark.parametrize("names, there, folder", [
    (("a.png", "b.png"), "images/left", "images"),  # they are one folder further down
    (("images/a.png", "images/b.png"), "images", "images"),  # the folder is named twice
    (("left/a.png", "left/b.png"), "images", "images"),  # the images were copied out of theirs
])
def test_images_of_colmap_one_folder_further_up_or_down_are_read_and_that_is_told(tmp_path, names, there, folder):
    picture(tmp_path / there / "a.png", 40)
    picture(tmp_path / there / "b.png", 200)
    model = colmap(tmp_path, *names)
    with pytest.warns(UserWarning) as caught:
        photographs = rb.Photographs.from_colmap(model, tmp_path / folder, curve="linear")
    assert [str(warning.message) for warning in caught] == [
        f"{tmp_path / there}: images of {model} are read there, none is in {tmp_path / folder}"]
    assert [float(each.image.mean()) for each in photographs] == pytest.approx([40 / 255, 200 / 255])
    with pytest.raises(SceneError, match="images of .* are read there, none is in"):
        rb.Photographs.from_colmap(model, tmp_path / folder, strict=True)


def test_images_in_two_folders_below_are_not_guessed(tmp_path):
    for folder in ("images_2", "images_4"):
        picture(tmp_path / folder / "a.png")
    with pytest.raises(ValueError, match="the image a.png is not in .*, and in .*images_2 and .*images_4; which is it"):
        rb.Photographs.from_colmap(colmap(tmp_path, "a.png"), tmp_path)


def test_each_image_may_be_in_a_folder_of_its_own_below(tmp_path):
    picture(tmp_path / "images" / "left" / "a.png", 40)
    picture(tmp_path / "images" / "right" / "b.png", 200)
    with pytest.warns(UserWarning, match="left: images of .* are read there"):
        photographs = rb.Photographs.from_colmap(colmap(tmp_path, "a.png", "b.png"), tmp_path / "images", curve="linear")
    assert [float(each.image.mean()) for each in photographs] == pytest.approx([40 / 255, 200 / 255])


def test_images_that_a_model_of_colmap_has_and_the_folder_has_not_are_left_out(tmp_path):
    picture(tmp_path / "images" / "b.png")
    model = colmap(tmp_path, "a.png", "b.png", "c.png")
    with pytest.warns(UserWarning, match="^a.png, c.png: left out of .*the image is not there"):
        assert rb.Photographs.from_colmap(model, tmp_path / "images").names == ["b_png"]
    with pytest.raises(FileNotFoundError, match="a.png: file not found, the image 'a.png' of the data set"):
        rb.Photographs.from_colmap(model, tmp_path / "images", missing="error")


def test_another_folder_of_images_may_have_their_folders_or_not(tmp_path):
    """images_4 of nerfstudio has what images has, and folders in it; and no two frames get one file."""
    path = write(tmp_path, "images/left/a.png", "images/right/a.png")
    for name, level in (("left", 40), ("right", 200)):
        picture(tmp_path / "images_4" / name / "a.png", level)
    photographs = silently(lambda: rb.Photographs.from_nerf(path, images=tmp_path / "images_4", curve="linear"))
    assert [float(each.image.mean()) for each in photographs] == pytest.approx([40 / 255, 200 / 255])
    picture(tmp_path / "flat" / "a.png")
    with pytest.raises(ValueError, match="the images images/left/a.png and images/right/a.png are one file, .*a.png"):
        rb.Photographs.from_nerf(path, images=tmp_path / "flat")
    path = write(tmp_path, "images/left/a.png")
    assert len(silently(lambda: rb.Photographs.from_nerf(path, images=tmp_path / "flat"))) == 1


def test_files_whose_cameras_have_no_size_are_told(tmp_path):
    """Neither w and h nor the whole images say it; reduced ones could not."""
    picture(tmp_path / "images_2" / "a.png", width=4, height=3)
    picture(tmp_path / "images_2" / "b.png", width=4, height=3)
    picture(tmp_path / "images" / "a.png")
    path = write(tmp_path, "images/a.png", "images/b.png", w=None, h=None)
    with pytest.raises(SceneError, match=r"frames\[1\]: the size of the image is not known.*give width= and height="):
        rb.Photographs.from_nerf(path, images=tmp_path / "images_2", scale=0.5)
    assert len(rb.Photographs.from_nerf(path, images=tmp_path / "images_2", scale=0.5, width=8, height=6)) == 2


def test_a_model_that_is_turned_is_told_by_its_file(tmp_path):
    """COLMAP's camera is 6 x 8, the file 8 x 6 with an orientation that turns it."""
    (tmp_path / "images").mkdir()
    exif = Image.Exif()
    exif[274] = 6
    Image.new("RGB", (8, 6)).save(tmp_path / "images" / "a.jpg", exif=exif)
    model = colmap(tmp_path, "a.jpg")
    (tmp_path / "cameras.txt").write_text("1 SIMPLE_PINHOLE 6 8 7 3 4\n")
    with pytest.raises(ValueError, match=r"a.jpg has 8 x 6 pixels, and its camera 'a_jpg' 6 x 8; its EXIF data .*tion 6"):
        rb.Photographs.from_colmap(model, tmp_path / "images")
    (tmp_path / "cameras.txt").write_text("1 SIMPLE_PINHOLE 12 16 7 3 4\n")
    with pytest.raises(ValueError, match=r"has 8 x 6 pixels, .* which is 6 x 8 with scale=0.5; its EXIF data say that"):
        rb.Photographs.from_colmap(model, tmp_path / "images", scale=0.5)
    assert torch.is_tensor(rb.Photographs.from_colmap(colmap(tmp_path, "a.jpg"), tmp_path / "images")[0].image)
