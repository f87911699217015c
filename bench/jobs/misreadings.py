"""Whether misread files are named, and right ones never: every entry of the table fed to every kind of robot.

    scripts/misreadings                 # every entry × kind, 500 right files: about fifteen minutes
    scripts/misreadings --quick

Right files are made of robots whose parts are off by up to 1 mm and 0.5° (2 % in ratios of motors), with noise.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pcalib import robot as robots
from pcalib import rotation, workspace
from pcalib.data import misreadings
from pcalib.data.measurement import Measurements
from pcalib.fitting import as_drawn, mixups
from pcalib.mechanics import kinematics
from pcalib.robot import MODELS, Robot

KINDS = ("delta", "hexa", "hexa321", "h4", "linear_delta", "hexapod", "planar")
ERRORS = {"m": 1e-3, "rad": np.radians(0.5), "1": 0.01}
"""Errors of parts are spread evenly up to these."""
SIGMA_POS, SIGMA_ROT = 20e-6, 90e-6
ROWS = 30


@dataclass(frozen=True)
class Misread:
    """One misread file."""

    kind: str
    entry: misreadings.Misreading
    visible: bool
    """Whether the misreading changes the data by more than their noise: one that does not cannot be named."""
    named: bool
    said: str


def right_file(robot: Robot, rng: np.random.Generator, frame: str = "base", full: bool = True) -> Measurements:
    """What an instrument reads of a robot that was put together without care."""
    mechanism = robot.mechanism
    size = np.array([ERRORS[unit] for unit in mechanism.units])
    planar = len(mechanism.plate_dofs) < 6
    while True:
        q = workspace.reachable(robot, ROWS, rng).q
        k = mechanism.nominal + size * rng.uniform(-1, 1, len(size))
        solution = kinematics.forward(mechanism, k, q)
        if solution.ok.all():
            break
    tool = np.array([0.03, -0.05, 0.0 if planar else -0.12])
    position = solution.pose.tcp(tool) + SIGMA_POS * rng.standard_normal((ROWS, 3))
    R = rotation.exp(SIGMA_ROT * rng.standard_normal((ROWS, 3))) @ solution.pose.R
    if frame == "tracker":
        turned = rotation.exp(rng.standard_normal(3))
        position, R = position @ turned.T + rng.standard_normal(3), turned @ R
    return Measurements.create(
        robot, q, position, R if full else None, tool=tool, sigma_pos=SIGMA_POS, sigma_rot=SIGMA_ROT, frame=frame
    )


def misread(kind: str, seed: int = 0, every: int = 1) -> Iterator[Misread]:
    """The entries of the table, or one of so many, each with a right file as someone with that mistake writes it."""
    robot = robots.load(MODELS / f"{kind}.toml")
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    data = right_file(robot, rng)
    table = misreadings.table(data, robot)
    for entry in [table[i] for i in sorted(rng.permutation(len(table))[: -(-len(table) // every)])]:
        written, drawn = entry.spoil(data, robot)
        found = mixups.judge(written, drawn)
        here = found.distance
        visible = here is None or not here.near or here.cost > mixups.OFF**2 * here.readings
        said = "; ".join(words for _, words, *_ in (*found.readings, *found.numbers)) or "nothing"
        yield Misread(kind, entry, visible, any(words == entry.words for _, words, _ in found.readings), said)


def false_alarms(count: int, seed: int = 0, tried: int = 20) -> Iterator[tuple[str, str]]:
    """Kind and message of files without a mistake, of all kinds, for which a misreading is reported.

    Args:
        tried: in every file whose number is a multiple of it all readings are tried, suspicious or not.
    """
    loaded = {kind: robots.load(MODELS / f"{kind}.toml") for kind in KINDS}
    rng = np.random.default_rng([seed, 1])
    for i in range(count):
        kind = KINDS[i % len(KINDS)]
        frame = "tracker" if i % 3 == 2 and kind != "planar" else "base"
        data = right_file(loaded[kind], rng, frame, full=i % 4 != 3)
        found = mixups.judge(data, loaded[kind], always=i % tried == 0)
        if found.readings or found.numbers or found.frame or found.far:
            yield kind, mixups.sentence(found, as_drawn.compare(data, loaded[kind]))


def main(arguments: list[str]) -> int:
    """Print both tables; 1 where fewer than 95 % of the visible misreadings are named, or a right file is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one entry of twenty, 35 right files")
    parser.add_argument("--seed", type=int, default=0)
    said = parser.parse_args(arguments)
    holds = True
    for kind in KINDS:
        trials = list(misread(kind, said.seed, 20 if said.quick else 1))
        seen = [t for t in trials if t.visible]
        named = sum(t.named for t in seen)
        holds &= named >= 0.95 * len(seen)
        print(f"{kind}: {named} of {len(seen)} named; {len(trials) - len(seen)} change nothing that these data show")
        for trial in seen:
            if not trial.named:
                print(f"  {trial.entry.code}: {trial.entry.words}\n    said: {trial.said}")
    count = 35 if said.quick else 500
    alarms = list(false_alarms(count, said.seed))
    print(f"right files of which something is said: {len(alarms)} of {count}")
    for kind, sentence in alarms:
        print(f"  {kind}: {sentence}")
    return 0 if holds and not alarms else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
