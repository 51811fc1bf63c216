"""Files: scenes (Mitsuba XML and dict), meshes (OBJ, PLY) and images (EXR, HDR, PFM, PNG, JPEG, BMP, TGA)."""
