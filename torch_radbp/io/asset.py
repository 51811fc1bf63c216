"""The scenes that come with the package, which tutorials and recipes use."""

from __future__ import annotations

from pathlib import Path

from torch_radbp.plugin.errors import nearest

PACKAGE = Path(__file__).parents[1]
# In an installed package they are within it, in the repository beside it.
FOLDER = next((folder for folder in (PACKAGE / "assets", PACKAGE.parent / "assets") if folder.is_dir()), None)
SCENES = "scene.xml", "*.glb"


def asset(name: str) -> Path:
    """The path of a file that comes with the package.

    Args:
        name: of a scene, such as ``"cornell_box/scene.xml"`` or ``"pot/pot.glb"``, or of another file of its folder;
            ``assets/README.md`` says what each is and where it is from.

    Raises:
        FileNotFoundError: there is none of this name; the message lists the scenes.
    """
    if FOLDER is None:
        raise FileNotFoundError("the scenes that come with the package are not beside it: install it again")
    path = FOLDER / name
    if not path.is_file():
        scenes = sorted(file.relative_to(FOLDER).as_posix() for pattern in SCENES for file in FOLDER.glob(f"*/{pattern}"))
        raise FileNotFoundError(f"no file {name!r} comes with the package; {nearest(name, scenes)}")
    return path
