"""How well deviations are predicted, and how soon Gauss-Newton is there: ``python -m benchmarks.uncertainty``.

*Calibration.* Each task is fitted to ``--refits`` targets by `rb.optim.GaussNewton`: a rendering of many samples, of a seed
of its own, with normal noise of 5 % of each pixel (and of 0.1). Printed are the standard deviations of what is found over
those that `rb.covariance` predicts, root mean square and median over parameters, the least and greatest of them, and the
share of the 95 % intervals that hold the truth. Fits begin at the truth: what is asked is the spread, not whether they
arrive. For more than 200 numbers deviations are those of `rb.diagonal_covariance`. Textures have a prior of 0.3 for each
number, networks and skies of 0.1, which fits have, too, around values that chance takes as far from the truth. Weights of a
network take each other's part: there, the colours that it returns are compared.

*Speed.* ``--speed``: from a start that is off, seconds until the root mean square of the relative errors of the parameters
is at most 1.2 times what Gauss-Newton ends with, for it and for Adam with each of five learning rates, of the same
renderer and loss, by two buffers of 16 or of 64 samples per pixel. Targets have no noise but that of their samples. The
first of Adam's steps that is there counts, even where the next is not; what is not there within ``--patience`` times
Gauss-Newton's seconds is printed as more than these.

*Views.* ``--views``: in random set-ups of a ball and a floor, seen by one camera, `rb.next_view` chooses one of five more;
all look at chance from near or far, at the ball or past it. Each candidate is then fitted, together with the first view and
with the prior, to noisy images; printed are in how many set-ups the error of its choice, root mean square in units of the
prior, is below that of the median candidate, and its rank.

Seconds are the processor's, with ``OMP_NUM_THREADS=1``, so that a busy machine changes little; what runs first, and
compiles, is not timed.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from benchmarks.uncertainty.calibration import calibrated
from benchmarks.uncertainty.races import raced
from benchmarks.uncertainty.tasks import TASKS
from benchmarks.uncertainty.views import views_of


@contextmanager
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tasks", nargs="*", default=[], help=f"of {', '.join(TASKS)}; none: all")
    parser.add_argument("--refits", type=int, default=100)
    parser.add_argument("--speed", action="store_true", help="beside Adam, instead of the calibration")
    parser.add_argument("--views", type=int, default=0, metavar="N", help="instead, the next view in N random set-ups")
    parser.add_argument("--patience", type=float, default=10.0)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    with one_thread():
        won = 0
        for number in range(given.views):
            errors = views_of(number, given.refits)
            chosen, median = errors[0], sorted(errors)[2]
            won += chosen < median
            print(f"set-up {number}: {chosen:.3f} of the prior by the view that is chosen, rank "
                  f"{1 + sorted(errors).index(chosen)}, {median:.3f} by the median one; better in {won} of {number + 1}",
                  flush=True)
        for name in [] if given.views else given.tasks or TASKS:
            task = TASKS[name]()
            found = raced(task, given.patience) if given.speed else calibrated(task, given.refits)
            print(f"{name:12} {task.size:4} parameters, {found}", flush=True)


if __name__ == "__main__":
    main()
