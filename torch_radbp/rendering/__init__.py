"""The user's interface to rendering: the renderer, its settings, and the plan of each call."""
