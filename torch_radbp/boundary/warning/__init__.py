"""Warnings about what a derivative lacks."""
