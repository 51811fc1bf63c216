"""A model in COLMAP's formats, as text and by hand in binary."""

from __future__ import annotations

import struct

CAMERAS = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 13
1 SIMPLE_PINHOLE 40 30 33.5 20 15
2 PINHOLE 40 30 33 34 20.5 14.5
3 SIMPLE_RADIAL 40 30 33 20 15 -0.1
4 RADIAL 40 30 33 20 15 -0.1 0.02
5 OPENCV 40 30 33 34 20 15 -0.1 0.02 0.003 -0.004
6 FULL_OPENCV 40 30 33 34 20 15 0.1 0.2 0.003 -0.004 0.3 0.4 0.5 0.6
7 OPENCV_FISHEYE 40 30 13 14 20 15 0.1 0.2 0.3 0.4
8 SIMPLE_RADIAL_FISHEYE 40 30 21 20 15 -0.04
9 RADIAL_FISHEYE 40 30 21 20 15 -0.04 0.01
10 FOV 40 30 26 27 20 15 0.9
11 THIN_PRISM_FISHEYE 40 30 21 22 20 15 -0.04 0.01 0.01 -0.02 0.003 -0.001 0.015 -0.01
12 SIMPLE_FISHEYE 40 30 21 20 15
13 FISHEYE 40 30 21 22 20 15
"""
IMAGES = """# Image list with two lines of data per image:
#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME
#   POINTS2D[] as (X, Y, POINT3D_ID)
1 1 0 0 0 0.1 0.2 0.3 2 first.jpg
12.5 7.5 -1 3.5 4.5 17
2 0.5 0.5 -0.5 0.5 -1 0.2 2 6 folder/second view.jpg

3 0.9238795 0 0.3826834 0 0 0 4 7 third.png
"""
NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5,
           "FULL_OPENCV": 6, "FOV": 7, "SIMPLE_RADIAL_FISHEYE": 8, "RADIAL_FISHEYE": 9, "THIN_PRISM_FISHEYE": 10,
           "SIMPLE_FISHEYE": 14, "FISHEYE": 15}


def binary(folder, cameras=CAMERAS, images=IMAGES):
    """The model in COLMAP's binary format, written by hand from its text: little-endian, without gaps."""
    lines = [line.split() for line in cameras.splitlines() if line and line[0] != "#"]
    content = struct.pack("<Q", len(lines))
    for camera, model, width, height, *parameters in lines:
        content += struct.pack("<IiQQ", int(camera), NUMBERS[model], int(width), int(height))
        content += struct.pack(f"<{len(parameters)}d", *map(float, parameters))
    (folder / "cameras.bin").write_bytes(content)
    lines = [line for line in images.splitlines() if not line.startswith("#")]
    content = struct.pack("<Q", len(lines[::2]))
    for image, points in zip(lines[::2], [*lines[1::2], ""]):
        number, *pose, camera, name = image.split(maxsplit=9)
        content += struct.pack("<I7dI", int(number), *map(float, pose), int(camera)) + name.encode() + b"\0"
        points = points.split()
        content += struct.pack("<Q", len(points) // 3)
        for x, y, point in zip(points[::3], points[1::3], points[2::3]):
            content += struct.pack("<ddq", float(x), float(y), int(point))
    (folder / "images.bin").write_bytes(content)
    return folder
