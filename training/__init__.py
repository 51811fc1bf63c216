"""Recover scene parameters from images: the `radbp` commands and the optimisation behind them.

The road of one `radbp optimize RECIPE.toml`:

    recipe_file   reads and checks the recipe                       -> Recipe
    parameters    finds the named parameters, sets initial values   -> list[RecoveredParameter]
    targets       reads the target images                           -> Targets
    optimize      the training loop: render, loss, backward, step   -> Outcome
    run_folder    keeps what a run leaves behind
    report        turns a run folder into one report.html
"""
