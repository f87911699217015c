"""Blind pairs of sessions: parts bent, swapped or slipped between them or at a row, and the score of what was said."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.jobs.blind import SEALED
from bench.jobs.changes import pairs, trials
from bench.jobs.changes.pairs import SETUPS, SIZES, Pair
from pcalib import files
from pcalib.data import measurement
from pcalib.errors import InputError
from pcalib.robot import Robot

SCHEMA = "pcbench.sealed_change/1"
WRITTEN_BY = "write it with pcalib changed NNN.csv --model NNN.toml --json NNN.changes.json"
SEALED_BY = "sealed changes are written by 'pcbench blind --changed', and not meant to be changed"
SHAPE = {"what": str, "truth": [str], "s": float, "distance": float, "row": int, "setup": str}
ANSWER = {"verdict": str, "established": [str], "adequate": [[str]]}


def make(robot: Robot, folder: Path, n: int, seed: int = 0, advance: Callable[[], None] = lambda: None) -> list[Path]:
    """Write n pairs NNN.first.csv and NNN.csv, and what changed in sealed files; the same seed gives the same bytes.

    Raises:
        InputError: the folder cannot be written, or holds other data sets; nothing is left behind.
    """
    if folder.exists() and any(folder.glob("*.csv")):
        raise InputError("there are data sets in this folder already", file=folder, remedy="name a new folder with -o")
    with files.atomic_folder(folder) as fresh:
        (fresh / SEALED).mkdir()
        files.write_text(fresh / "robot.toml", robot.text)
        for index in range(1, n + 1):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(pairs.STREAM, index, 2)))
            what = trials.PACK[(index - 1) * 3 % len(trials.PACK)]
            drawn = Pair.draw(robot, SIZES[index % 2], SETUPS[index % 3], rng)
            moved, sizes, s, far, slip = trials.hidden(drawn, what, False, rng)
            measurement.save(fresh / f"{index:03d}.first.csv", drawn.first)
            measurement.save(fresh / f"{index:03d}.csv", drawn.second(moved, sizes, slip))
            facts = {
                "schema": SCHEMA, "data": f"{index:03d}.csv", "what": what, "truth": sorted(m.name for m in moved),
                "sizes": [float(size) for size in sizes], "s": s, "distance": far, "row": slip, "setup": drawn.setup,
            }  # fmt: skip
            files.write_text(fresh / SEALED / f"{index:03d}.json", json.dumps(facts, indent=2) + "\n")
            advance()
    return [folder / f"{index:03d}.csv" for index in range(1, n + 1)]


def holds_changes(folder: Path) -> bool:
    """Whether a folder holds pairs of sessions."""
    sealed = sorted((folder / SEALED).glob("*.json"))
    return bool(sealed) and files.parse_json(files.read_text(sealed[0]), sealed[0], SEALED_BY).get("schema") == SCHEMA


def score(folder: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """A row for every answer NNN.changes.json, as those of the study, and the names of pairs without one.

    Raises:
        InputError: an answer or a sealed change that is none.
    """
    rows, missing = [], []
    for path in sorted((folder / SEALED).glob("*.json")):
        facts = files.parse_json(files.read_text(path), path, SEALED_BY)
        files.require_shape(facts, SHAPE, path, SEALED_BY)
        answer = folder / f"{path.stem}.changes.json"
        if not answer.exists():
            missing.append(path.stem)
            continue
        said = files.parse_json(files.read_text(answer), answer, WRITTEN_BY)
        files.require_shape(said, ANSWER, answer, WRITTEN_BY)
        rows.append({"name": path.stem, **facts, **_columns(said)})
    return rows, missing


def _columns(said: Mapping[str, Any]) -> dict[str, Any]:
    slip = said.get("slip")
    return {
        "verdict": said["verdict"],
        "established": [trials.name_of(name) for name in said["established"]],
        "adequate": [[trials.name_of(name) for name in names] for names in said["adequate"]],
        "slip": slip["row"] - 1 if isinstance(slip, Mapping) and isinstance(slip.get("row"), int) else -1,
    }
