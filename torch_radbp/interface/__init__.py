"""Interfaces between plugins and the path tracer: all it knows of materials, lights, textures, media."""
