"""Scenes and cameras from files and back: Mitsuba XML and dict, glTF; COLMAP, NeRF, OpenCV."""
