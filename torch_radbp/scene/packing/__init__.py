"""Packs the scene's modules into its tables, by ordinary differentiable torch."""
