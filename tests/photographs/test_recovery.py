"""From a folder of photographs to reflectance and exposure, by the example of the README as it stands there."""

import re
from pathlib import Path

import torch

import torch_radbp as rb
from tests.photographs.nerf_folder import GAINS, REFLECTANCE, ball_in_the_open, write_photographs

README = Path(__file__).parents[2] / "README.md"


def test_reflectance_and_gains_are_recovered_from_coded_photographs(tmp_path, monkeypatch):
    """8 bits of sRGB and a gain each; what is left is noise of 4 samples, which steps that shrink to a tenth average."""
    section = README.read_text(encoding="utf-8").split("\n## Photographs\n")[1].split("\n## ")[0]
    example, = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    write_photographs(tmp_path)
    monkeypatch.chdir(tmp_path)
    found = {"rb": rb, "torch": torch, "objects": ball_in_the_open(0.5, 0.5, 0.5)}
    exec(example, found)
    torch.testing.assert_close(found["reflectance"].detach(), torch.tensor(REFLECTANCE), rtol=0, atol=0.01)
    gains = found["exposure"].gains.detach()
    torch.testing.assert_close(gains, GAINS[:, None].expand(-1, 3), rtol=0, atol=0.01)
    assert torch.equal(gains[0], torch.ones(3))
