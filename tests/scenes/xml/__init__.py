"""Scenes in Mitsuba's XML, which both renderers read: those whose images are compared."""
