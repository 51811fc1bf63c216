"""Files: scenes (Mitsuba XML and dict, glTF), cameras (COLMAP, NeRF), meshes (OBJ, PLY, serialized) and images."""
