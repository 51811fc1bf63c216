"""Contents of `transforms.json`, as of Blender's scenes and as of OpenCV's cameras."""

from __future__ import annotations

from torch_radbp.io.values.transform import rotate, translate

POSE = (translate((1, 2, 3)) @ rotate((0.3, 1, 0.2), 50)).tolist()
BLENDER = {"camera_angle_x": 0.7, "frames": [{"file_path": "./train/r_0", "rotation": 0.01, "transform_matrix": POSE}]}
OPENCV = {"camera_model": "OPENCV", "fl_x": 33, "fl_y": 34, "cx": 20.5, "cy": 14.5, "w": 40, "h": 30, "k1": -0.1, "k2": 0.02,
          "p1": 0.003, "p2": -0.004, "aabb_scale": 16,
          "frames": [{"file_path": "images/a.jpg", "transform_matrix": POSE},
                     {"file_path": "images/b.jpg", "transform_matrix": POSE[:3], "fl_x": 50, "w": 44}]}
