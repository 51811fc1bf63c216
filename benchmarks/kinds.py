"""What eight kinds of material cost beside one: ``python -m benchmarks.kinds``.

The room of `versus_mitsuba` with things of eight kinds, and all of one kind, for each that can be a wall. All take turns
within one process, compiled and then eager; CPU seconds of all threads. Paths differ in length (glass and mirrors are not
black), so that the ratio by ray is printed beside the ratio of seconds.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path

from benchmarks.peers import Ours
from benchmarks.scenes import QUICK, material_room

EIGHT = "eight kinds"


class Counted:
    """A room that is rendered again and again, with the rays that it casts."""

    def __init__(self, ours: Ours):
        self.ours, self.seconds, self.rays = ours, [], 0
        ours.run(10_000)
        ours.run(10_001)

    def run(self, seed: int) -> None:
        before = self.ours.renderer.last_caster.rays_cast
        self.seconds.append(self.ours.run(seed).cpu)
        self.rays = self.ours.renderer.last_caster.rays_cast - before

    @property
    def median(self) -> float:
        return statistics.median(self.seconds)


def measure(compiled: bool, rounds: int, quick: bool) -> dict[str, Counted]:
    """The rooms by name, measured in turns."""
    setting = QUICK if quick else material_room.SETTING
    with tempfile.TemporaryDirectory() as folder:
        scenes = {EIGHT: material_room.material_room(Path(folder), setting)}
    scenes |= {kind: material_room.one_kind_room(kind, setting) for kind in material_room.OPAQUE}
    rooms = {name: Counted(Ours(scene, compiled)) for name, scene in scenes.items()}
    for seed in range(rounds):
        for room in rooms.values():
            room.run(seed)
    return rooms


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    options = parser.parse_args()
    print("| | room | forward + backward, CPU s | million rays | eight over this | by ray |\n|---|---|---|---|---|---|")
    for mode in ("compiled", "eager"):
        rooms = measure(mode == "compiled", options.rounds, options.quick)
        eight = rooms[EIGHT]
        for name, room in rooms.items():
            ratio = eight.median / room.median
            print(f"| {mode} | {name} | {room.median:.3f} | {room.rays / 1e6:.2f} | {ratio:.2f} | "
                  f"{ratio * room.rays / eight.rays:.2f} |", flush=True)


if __name__ == "__main__":
    main()
