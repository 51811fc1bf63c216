"""Paths that begin at lamps: images, derivatives, and which light is whose."""
