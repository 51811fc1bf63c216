"""Files: scenes (Mitsuba XML and dict), meshes (OBJ, PLY) and images (EXR, PNG, JPEG)."""
