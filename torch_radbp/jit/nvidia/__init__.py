"""NVIDIA's GPUs as a target: programs as PTX, recordings as launches one after the other."""
