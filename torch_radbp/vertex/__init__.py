"""A vertex of a path: the point that a ray meets, its material, what it emits, and the ray that leaves it."""
