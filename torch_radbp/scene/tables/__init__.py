"""The scene as the path tracer reads it: one record of flat tensors, and what lanes look up in it."""
