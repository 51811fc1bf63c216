"""Connections of a point to the lights: points sampled on lights, and what media leave of their light."""
