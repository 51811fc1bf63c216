"""The five tasks; each writes the files that it needs into a folder."""

from benchmarks.headline.tasks.cornell import cornell
from benchmarks.headline.tasks.interior import interior
from benchmarks.headline.tasks.pose import pose
from benchmarks.headline.tasks.shape import shape
from benchmarks.headline.tasks.sky import sky

TASKS = {"cornell": cornell, "interior": interior, "sky": sky, "pose": pose, "shape": shape}
