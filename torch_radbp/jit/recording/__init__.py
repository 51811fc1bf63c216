"""Recordings: what a step does with lanes, as data; and the same done at once by torch's operations."""
