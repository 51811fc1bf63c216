"""The scene as its user sees it: a tree of modules, its parameters and their ranges."""
