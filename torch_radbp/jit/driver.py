"""CUDA's driver."""


def driver_of(device):
    raise RuntimeError("not yet")
