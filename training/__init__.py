"""Recover scene parameters from images: the `radbp` commands and the optimisation behind them.

The steps of one `radbp optimize RECIPE.toml`:

    bundled       finds the recipe, by path or name
    recipe_file   reads and checks it                               -> Recipe
    parameters    finds the named parameters, sets initial values   -> list[RecoveredParameter]
    targets       reads the target images                           -> Targets
    optimize      the training loop: render, loss, backward, step   -> Recovery
    interrupt     ends it on Ctrl-C and SIGTERM
    run_folder    keeps what a run leaves behind; checkpoint its state, which continuation compares with a run
    outcome       images and values of the state reached; verdict judges loss and parameters
    report        turns a run folder into one report.html
"""
