"""Blind tests: data files whose hidden faults lie sealed beside them, to be diagnosed and then scored.

    DIR/001.csv …                   the data
    DIR/robot.toml                  the robot as drawn
    DIR/sealed/001.truth.toml …     the robot as it is, for `pcbench verify`
    DIR/sealed/001.json …           what is hidden and how visible it is, for `pcbench score`
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench import pool
from bench import truth as truths
from bench.jobs.hidden import case as cases
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.case import Case
from bench.jobs.hidden.catalogue import CATALOGUE, Hidden
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.grading import SLACK, Facts
from bench.jobs.hidden.stage import Stage, suits
from pcalib import files
from pcalib import robot as robots
from pcalib.data import measurement
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError
from pcalib.robot import Robot

SCHEMA = "pcbench.sealed/1"
POSES = [name for name, design in DESIGNS.items() if not design.sensors and not design.instrument_settings]
"""Designs of blind sets: poses with one σ."""
SEALED = "sealed"
STREAM, DEALT = 0xB11D, 0xDEA1
KINDS = {"none": 4, "single": 10, "pair": 3, "outside": 3}
"""Number of data sets of each kind among twenty in a row."""
SIZES = (4.0, 20.0)
"""Visible sizes s (of pairs and unlisted faults: s⊥), log-uniform."""
PAIRED = 8.0
"""Smallest s⊥ of pairs and of faults that are not in the library."""
TRIES = 12


@dataclass(frozen=True, eq=False)
class Blind:
    """One data set and its truth."""

    data: Measurements
    truth: str
    """Text of its truth file."""
    facts: dict[str, Any]
    """What its JSON says."""


def make(
    robot: Robot,
    folder: Path,
    n: int,
    seed: int = 0,
    workers: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write n data sets and their sealed truths; the same seed gives the same bytes.

    Raises:
        InputError: the folder cannot be written, or holds other data sets; nothing is left behind.
    """
    if n < 1 or seed < 0 or workers < 1:
        asked = f"cannot make {n} data sets with seed {seed} on {workers} processes"
        raise InputError(asked, remedy="use at least one data set, a seed from 0 on and at least one process")
    if folder.exists() and any(folder.glob("*.csv")):
        raise InputError("there are data sets in this folder already", file=folder, remedy="name a new folder with -o")
    _require_suited(robot)
    names = []
    with files.atomic_folder(folder) as fresh:
        (fresh / SEALED).mkdir()
        files.write_text(fresh / "robot.toml", robot.text)
        for index, blind in enumerate(pool.ordered(partial(_draw, robot.text, seed), range(1, n + 1), workers), 1):
            name = f"{index:03d}"
            measurement.save(fresh / f"{name}.csv", blind.data)
            files.write_text(fresh / SEALED / f"{name}.truth.toml", blind.truth)
            content = {"schema": SCHEMA, "data": f"{name}.csv", **blind.facts}
            files.write_text(fresh / SEALED / f"{name}.json", json.dumps(content, indent=2) + "\n")
            names.append(f"{name}.csv")
            advance()
    return [folder / name for name in names]


def _require_suited(robot: Robot) -> None:
    """Refuse a robot that cannot have every fault of the catalogue."""
    for hidden in CATALOGUE.values():
        try:
            hidden.needs(robot)
        except InputError:
            raise InputError(
                f"robot '{robot.name}' (kind {robot.kind}) cannot have every fault that is hidden: {hidden.name}",
                remedy="use a robot whose motors turn arms, such as models/delta.toml",
            ) from None


def _draw(text: str, seed: int, index: int) -> Blind:
    """One data set, in whatever process."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return draw(robots.parse(text, "robot"), seed, index)


def draw(robot: Robot, seed: int, index: int) -> Blind:
    """One data set: design, robot, poses, faults and noise depend on seed and index alone."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, index)))
    design = DESIGNS[str(rng.choice(POSES))]
    stage = Stage.draw(design, robot, int(rng.integers(2**31)))
    size = float(np.round(np.exp(rng.uniform(*np.log(SIZES))), 1))
    case = _case(kind_of(seed, index), stage, size, rng)
    noise = int(rng.integers(2**31))
    facts = {
        "kind": case.facts.kind,
        "design": design.name,
        "effects": list(case.facts.effects),
        "faults": [
            {"fault": name, "effect": CATALOGUE[name].effect, "s": s}
            for name, s in zip(case.facts.faults, case.sizes, strict=True)
        ],
        "s": case.facts.size,
        "s_outside": case.facts.distance,
        "nearest": list(case.nearest),
        "sigma_pos_um": design.sigma_pos * 1e6,
        "sigma_rot_urad": design.sigma_rot * 1e6,
        "stated_over_true": design.stated,
    }
    truth = truths.dumps(stage.truth(case.hidden), {"job": "blind", "seed": seed, "index": index, "noise_seed": noise})
    return Blind(case.measure(noise), truth, facts)


def kind_of(seed: int, index: int) -> str:
    """What is hidden in a data set: dealt from shuffled packs, so that even few sets are of all kinds."""
    pack = [kind for kind, count in KINDS.items() for _ in range(count)]
    number, place = divmod(index - 1, len(pack))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(DEALT, number)))
    return pack[rng.permutation(len(pack))[place]]


def _case(kind: str, stage: Stage, size: float, rng: np.random.Generator) -> Case:
    """Faults are drawn until they reach the size on these poses."""

    def drawn(names: tuple[str, ...], count: int) -> list[tuple[Hidden, Any]]:
        listed = [CATALOGUE[name] for name in names]
        usable = [w for w in listed if suits(w, stage.design, stage.robot) and not w.companion]
        chosen = [usable[i] for i in rng.choice(len(usable), count, replace=False)]
        return [(w, w.draw(stage.robot, rng, uneven=bool(rng.random() < 0.3))) for w in chosen]

    for _ in range(TRIES):
        if kind == "single":
            [(what, fault)] = drawn(catalogue.LISTED, 1)
            case = cases.single(stage, what, fault, size)
            if case.facts.size >= SLACK * size:
                return case
        elif kind == "pair":
            both = drawn(catalogue.LISTED, 2)
            if len({what.effect for what, _ in both}) < 2:
                continue
            case = cases.pair(stage, [w for w, _ in both], [f for _, f in both], max(size, PAIRED))
            if case is not None:
                return case
        elif kind == "outside":
            [(what, fault)] = drawn(catalogue.UNLISTED, 1)
            case = cases.outside(stage, what, fault, max(size, PAIRED))
            if case.facts.distance >= SLACK * max(size, PAIRED):
                return case
    return cases.nothing(stage)


SHAPE = {"effects": [str], "faults": [{"fault": str}], "s": float, "s_outside": float}
"""What a sealed JSON has to hold."""


def facts_of(content: dict[str, Any]) -> Facts:
    """The facts of a sealed JSON."""
    return Facts(
        tuple(sorted(content["effects"])),
        tuple(f["fault"] for f in content["faults"]),
        float(content["s"]),
        float(content["s_outside"]),
    )
