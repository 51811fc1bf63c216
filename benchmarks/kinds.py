"""What many kinds of material cost beside one: ``python -m benchmarks.kinds`` and ``--rooms principled``.

The room of `versus_mitsuba` with things of eight kinds, and all of one kind, for each that can be a wall; or its interior
with twenty principled materials of twenty sets of parameters, with twenty of one set, and with one of them. All take turns
within one process, compiled and then eager; CPU seconds of all threads. Paths differ in length (glass and mirrors are not
black), so that the ratio by ray is printed beside the ratio of seconds.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path

from benchmarks.peers import Ours
from benchmarks.scenes import QUICK, BenchmarkScene, material_room, principled_interior


def rooms_of_kinds(folder: Path, quick: bool) -> dict[str, BenchmarkScene]:
    """The room of eight kinds, then one for each kind that can be a wall."""
    setting = QUICK if quick else material_room.SETTING
    return {"eight kinds": material_room.material_room(folder, setting),
            **{kind: material_room.one_kind_room(kind, setting) for kind in material_room.OPAQUE}}


def rooms_of_principled(folder: Path, quick: bool) -> dict[str, BenchmarkScene]:
    """The room of twenty principled materials, then others with one set of parameters."""
    setting = QUICK if quick else principled_interior.SETTING
    ones = {"one, colour and roughness": 1, "one, metal and clearcoat": principled_interior.ALIKE, "one, all but glass": 19}
    return {"twenty sets": principled_interior.principled_interior(folder, setting),
            "twenty of one set": principled_interior.alike_interior(folder, setting),
            **{name: principled_interior.one_material_interior(folder, setting, number) for name, number in ones.items()}}


ROOMS = {"kinds": rooms_of_kinds, "principled": rooms_of_principled}


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


def measure(compiled: bool, options: argparse.Namespace) -> dict[str, Counted]:
    """The rooms by name, measured in turns."""
    with tempfile.TemporaryDirectory() as folder:
        scenes = ROOMS[options.rooms](Path(folder), options.quick)
        rooms = {name: Counted(Ours(scene, compiled)) for name, scene in scenes.items()}
    for seed in range(options.rounds):
        for room in rooms.values():
            room.run(seed)
    return rooms


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", choices=ROOMS, default="kinds")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--modes", choices=("compiled", "eager"), nargs="+", default=["compiled", "eager"])
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    options = parser.parse_args()
    print("| | room | forward + backward, CPU s | million rays | first room over this | by ray |\n|---|---|---|---|---|---|")
    for mode in options.modes:
        rooms = measure(mode == "compiled", options)
        first = next(iter(rooms.values()))
        for name, room in rooms.items():
            ratio = first.median / room.median
            print(f"| {mode} | {name} | {room.median:.3f} | {room.rays / 1e6:.2f} | {ratio:.2f} | "
                  f"{ratio * room.rays / first.rays:.2f} |", flush=True)


if __name__ == "__main__":
    main()
