"""Time to equal error, beside Mitsuba: five tasks of inverse rendering, by `python -m benchmarks.headline`."""
