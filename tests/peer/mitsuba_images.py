"""Mitsuba's side of the comparison: renders the cases, and stores what the tests need of them in ``reference/``.

    python -m tests.peer.mitsuba_images            # all, needs mitsuba==3.9.1 and LLVM; a few minutes on two cores
    python -m tests.peer.mitsuba_images sky points  # these only

One .npz per case: mean and standard error of independent renders at each scale of `agreement`, and the digest of the
scene they belong to.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.scenes.xml.cases import CASES
from tests.scenes.xml.files import Case, Folder

from .agreement import SCALES, Estimate, estimate

REFERENCE = Path(__file__).parent / "reference"
FIRST_SEED = 1000  # far from the seeds of our own renders; nothing depends on it


def digest(case: Case, folder: Folder) -> str:
    """Identifies a built case: the contents of its files and its variables."""
    contents = folder.contents.copy()
    contents.update(json.dumps([case.variables, case.peer_integrator], sort_keys=True).encode())
    return contents.hexdigest()


def scalar_mitsuba():
    """The module `mitsuba` in its variant `scalar_rgb`, which needs nothing else."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)  # bitmaps brighter than 1 are meant
    return mi


def mitsuba_of(case: Case):
    """The module `mitsuba` in the variant that a case is rendered with.

    `scalar_rgb` needs nothing else, but looks wide filters up in tables of 31 entries, which shifts parts of an image by
    0.05 % of what `llvm_ad_rgb`, which evaluates them, gives.
    """
    mi = scalar_mitsuba()
    if case.thin > 1:
        mi.set_variant("llvm_ad_rgb")
    return mi


def render(path: Path, case: Case, spp: int, batches: int, first_seed: int = FIRST_SEED, mi=None) -> list[np.ndarray]:
    """Independent (H, W, 3) renders of a built case by Mitsuba, linear RGB; `mi`: in a variant other than its own."""
    mi = mitsuba_of(case) if mi is None else mi
    theirs = path.with_name("peer.xml")
    theirs.write_text(path.read_text().replace('<integrator type="path">', f'<integrator type="{case.peer_integrator}">'))
    scene = mi.load_file(str(theirs), **case.variables)
    return [np.array(mi.render(scene, spp=spp, seed=first_seed + batch)) for batch in range(batches)]


def store(name: str) -> dict[str, Estimate]:
    """Renders one case with Mitsuba and writes its reference."""
    import mitsuba as mi

    case = CASES[name]
    with tempfile.TemporaryDirectory() as path:
        folder = Folder(Path(path))
        file = case.build(folder)
        estimates = estimate(render(file, case, case.peer_spp, case.peer_batches), case.peer_spp)
        arrays = {f"{scale}_mean": estimates[scale].mean.astype(np.float32) for scale in SCALES}
        arrays |= {f"{scale}_error": estimates[scale].error.astype(np.float32) for scale in SCALES}
        arrays |= {f"{scale}_samples": estimates[scale].samples for scale in SCALES}
        REFERENCE.mkdir(exist_ok=True)
        np.savez_compressed(REFERENCE / f"{name}.npz", batches=case.peer_batches, spp=case.peer_spp, mitsuba=mi.__version__,
                            digest=digest(case, folder), **arrays)
    return estimates


def load(name: str, expected_digest: str) -> dict[str, Estimate]:
    """The stored reference of a case.

    Raises:
        ValueError: if the scene has changed since.
    """
    with np.load(REFERENCE / f"{name}.npz") as file:
        if str(file["digest"]) != expected_digest:
            raise ValueError(f"reference/{name}.npz belongs to another version of the scene; "
                             f"run python -m tests.peer.mitsuba_images {name}")
        return {scale: Estimate(file[f"{scale}_mean"].astype(np.float64), file[f"{scale}_error"].astype(np.float64),
                                int(file["batches"]), int(file[f"{scale}_samples"])) for scale in SCALES}


def load_case(name: str, folder: Path) -> tuple[Case, Path, dict[str, Estimate]]:
    """Builds a case into ``folder``: the case, its scene file and Mitsuba's stored estimates."""
    case, files = CASES[name], Folder(folder)
    path = case.build(files)
    return case, path, load(name, digest(case, files))


if __name__ == "__main__":
    for each in sys.argv[1:] or CASES:
        result = store(each)["whole"]
        figures = f"mean {result.mean.ravel().round(5)}, error {(result.error / result.mean).ravel().round(5)}"
        print(f"{each}: {figures}", flush=True)
