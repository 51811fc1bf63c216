"""How well deviations are predicted, how soon Gauss-Newton is there, and what the next view is worth."""
