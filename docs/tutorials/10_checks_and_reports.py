# %% [markdown]
# # Reading a gradient check, and a report
#
# An optimisation that does not converge has many causes; a wrong derivative is one that can be ruled out in a minute.
# This tutorial reads what `rb.check_gradient` says, in a case that is right and one where something is missing, and
# then what a run of `radbp optimize` leaves behind.

# %%
import json
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt

import torch_radbp as rb

# %% [markdown]
# ## A check
#
# It moves one parameter along one direction and renders the change twice: as a difference of images, which knows
# nothing of derivatives, and by forward mode, from other samples. Both are noisy, so that each pixel's deviation is
# measured in standard errors, *z*. Then it compares forward and backward mode on the same samples, where they must
# agree to rounding.

# %%
box = rb.load(rb.asset("cornell_box/scene.xml"), resolution=128)
good = rb.check_gradient(box, "red.reflectance.value", spp=16, max_depth=5)
print(good)

# %% [markdown]
# "Agrees" alone would mean little: the line about what would have been noticed says how large a bias could hide in the
# noise.
#
# ## A check that fails
#
# The same for a block that moves between two lamps and the floor, without the term of shadows. Nothing else changes in
# this image.

# %%
shadow = rb.load(rb.asset("shadow/scene.xml"), resolution=128)
with warnings.catch_warnings():
    warnings.simplefilter("ignore", rb.SilhouetteWarning)  # shadows are missing: we know
    terms = "interior", "primary"
    bad = rb.check_gradient(shadow, "block.to_world", spp=32, terms=terms)
print(bad.verdict, "-", bad.explanation)
full = rb.check_gradient(shadow, "block.to_world", spp=32)
print("with all terms:", full.verdict, "-", full.explanation)

figure, axes = plt.subplots(1, 3, figsize=(9, 3.2))
pictures = {"differences": full.comparison.difference, "all terms": full.comparison.jvp,
            "no shadows": bad.comparison.jvp}
scale = full.comparison.jvp.abs().max().item() / 4
for axis, (title, picture) in zip(axes, pictures.items()):
    axis.imshow(picture[0].mean(0), cmap="RdBu", vmin=-scale, vmax=scale)
    axis.set_title(title)
    axis.axis("off")
plt.show()

# %% [markdown]
# "Too noisy" is no agreement: nothing speaks against the derivative, and an error that matters could still hide. More
# samples, or a larger step, decide it; borders of shadows are noisy, since few paths meet them. "Too large a step" says that
# the differences are off, as halving their step shows, and not the derivative.
#
# ## A run and its report
#
# `radbp optimize` runs recipes; the bundled ones are listed by `--list`. Here the colours of three walls, in fewer steps
# than the recipe asks for. What it prints ends with a verdict, which looks at the loss *and* at each parameter.

# %%
with tempfile.TemporaryDirectory() as folder:
    run = Path(folder, "run")
    command = [sys.executable, "-m", "torch_radbp.training.cli", "optimize", "--out", run,
               "cornell_reflectance", "--steps", "80", "-D", "report.spp=64"]
    done = subprocess.run(command, capture_output=True, text=True)
    summary = json.loads((run / "summary.json").read_text())
    print("\n".join(line.rstrip() for line in done.stdout.splitlines()[-24:]))
    print(sorted(path.name for path in run.iterdir()))
    pictures = sorted((run / "images").rglob("*.png"))
    images = {path.stem: plt.imread(path) for path in pictures}

# %% [markdown]
# The page `report.html` in that folder has these pictures, the curves of the loss and of every parameter, and the
# timing; it needs no network. Judge a run by the running mean of the loss: the two-buffer loss is negative half of the
# time once it has converged.

# %%
figure, axes = plt.subplots(1, len(images), figsize=(3 * len(images), 3.2))
for axis, (title, image) in zip(axes, images.items()):
    axis.imshow(image)
    axis.set_title(title)
    axis.axis("off")
plt.show()
assert summary["step"] == 80 and good.agrees
assert bad.verdict.startswith("biased") and full.verdict in ("agrees", "too noisy")
