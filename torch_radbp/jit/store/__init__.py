"""Compiled code on disk, by digests of all that it depends on."""
