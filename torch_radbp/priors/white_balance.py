"""A prior of colours that are grey on average."""

from __future__ import annotations

from torch import Tensor


def white_balance(colours: Tensor) -> Tensor:
    """The variance, over red, green and blue, of the logarithm of the mean colour; 0 if that is grey.

    Light that is twice as red and things that are half as red look the same, so that photographs leave the colour of light
    to guesses. This one says that the mean is grey: of the gains of all views, `exposure.gains`, that photographers did not
    err in one direction; of a lamp's radiance that it is white; of a map that its world is grey.

    Args:
        colours: (..., 3) linear, with a mean above 0, which is taken over all axes but the last; attached.

    Returns:
        A scalar, in squared natural logarithms: 0.01 is about a tenth of difference.

    Raises:
        ValueError: for another shape, or if a channel is nowhere above 0.

    Reference: Buchsbaum 1980, "A Spatial Processor Model for Object Colour Perception" (the grey world).
    """
    if colours.ndim < 1 or colours.shape[-1] != 3 or colours.numel() == 0:
        raise ValueError(f"colours must have shape (..., 3), got {tuple(colours.shape)}")
    mean = colours.reshape(-1, 3).mean(0)
    if not bool((mean > 0).all()):
        raise ValueError(f"the mean of colours must be above 0 in every channel, got {mean.tolist()}")
    return mean.log().var(unbiased=False)
