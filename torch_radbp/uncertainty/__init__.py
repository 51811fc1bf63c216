"""How far parameters that were found from images can be trusted: curvature, covariance, and the next view."""
