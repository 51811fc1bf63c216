"""Boundary terms: derivatives from an image's discontinuities, as silhouettes, which derivatives of radiance miss: the
curves (`curve`), who sees them (`eye`), the terms (`terms`), and warnings (`warning`).
"""
