"""Trials of the study of changes: one pair of sessions each, or a year of weekly checks of one robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench import plan as plans
from bench.jobs import verify
from bench.jobs.changes import pairs
from bench.jobs.changes.pairs import KINDS, SETUPS, SIZES, Moved, Pair
from pcalib.changes.results import Changes, Verdict
from pcalib.changes.search import changes
from pcalib.changes.update import update
from pcalib.errors import FitError
from pcalib.fitting import identification
from pcalib.model import Model
from pcalib.prediction import Conditions

PACK = ("nothing",) * 4 + ("single",) * 3 + ("pair",) * 2 + ("slip",)
"""What is hidden in ten pairs of one robot, size and set-up."""
SEEN = (6.0, 40.0)
"""Noise units of single changes, log-uniform; of those at once the smaller is 10 at least."""
LISTED = 0.25
"""Share of single changes that are a listed effect, of robots that can have one."""
SLIPPERY = 3
"""Most directions of a part that slips within a session."""
TRIES = 6
TARGETS = 60
"""Targets to land on after an update."""
WEEKS = 52
ROD = 30e-6
"""[m] change of a rod, or of a leg, that a weekly check has to find."""


def pair(seed: int, number: int) -> dict[str, Any]:
    """One pair of sessions, what pcalib says about it, and where the robot lands after an update."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(pairs.STREAM, number)))
    kind, n = KINDS[number % 3], SIZES[(number // 3) % 2]
    setup, what = SETUPS[(number // 6) % 3], PACK[(number // 18 + 3 * number) % len(PACK)]
    listed = what == "single" and bool(pairs.EFFECTS[kind]) and bool(rng.random() < LISTED)
    drawn = Pair.draw(kind, n, setup, rng, listed)
    row: dict[str, Any] = {"kind": kind, "n": n, "setup": setup, "what": what, "stated": drawn.stated}
    moved, sizes, s, far, slip = hidden(drawn, what, listed, rng)
    found = changes(drawn.model, drawn.second(moved, sizes, slip), setup == "same")
    row |= {"truth": sorted(m.name for m in moved), "s": s, "distance": far, "row": slip, **answer(found)}
    if what == "single" and n == min(SIZES) and not listed:
        row |= landed(drawn, moved, sizes, found, setup == "same")
    return row


def hidden(
    drawn: Pair, what: str, listed: bool, rng: np.random.Generator
) -> tuple[list[Moved], list[float], float, float, int]:
    """What changes, its sizes, how far it is seen in noise units, s⊥ of two changes at once, and the row of a slip."""
    if what == "nothing":
        return [], [], 0.0, 0.0, 0
    wanted = float(np.exp(rng.uniform(*np.log(SEEN))))
    names = pairs.names(drawn.robot)
    moved, sizes, s, far, row = [], [], 0.0, 0.0, 0
    for _ in range(TRIES):
        row = 0
        if what == "pair":
            moved = [pairs.part(drawn.robot, str(name), rng) for name in rng.choice(names, 2, replace=False)]
            sizes = [drawn.sized(m, max(wanted, 10.0))[0] for m in moved]
            far = pairs.distance(drawn, moved, sizes)
            s = float(np.linalg.norm(drawn.visible(moved, sizes)[0]))
            if far >= 8.0:
                break
            continue
        if what == "slip":
            small = [p.name for p in drawn.robot.mechanism.parts if p.basis.shape[1] <= SLIPPERY]
            row = int(rng.integers(3, len(drawn.plan) - 2))
            moved = [pairs.part(drawn.robot, str(rng.choice(small)), rng)]
        elif listed:
            moved = [pairs.effect(drawn.robot, str(rng.choice(pairs.EFFECTS[drawn.robot.kind])))]
        else:
            moved = [pairs.part(drawn.robot, str(rng.choice(names)), rng)]
        size, s = drawn.sized(moved[0], wanted, row)
        sizes = [size]
        if s >= 0.95 * SEEN[0]:
            return moved, sizes, s, 0.0, row
    return moved, sizes, s, far, row


def answer(found: Changes) -> dict[str, Any]:
    """The answer of pcalib as columns of a row."""
    members = [m for e in found.sets[:1] for m in e.members]
    slips = [m.slip for m in members if m.slip is not None]
    return {
        "verdict": found.verdict.value,
        "adequate": [[name_of(name) for name in e.names] for e in found.sets],
        "established": [name_of(name) for name in found.established],
        "slip": slips[0].row if slips else -1,
        "p": found.p,
    }


def name_of(name: str) -> str:
    """The name of a part; of a slip, written 'part@row', without its row."""
    return name.partition("@")[0]


def landed(drawn: Pair, moved: Sequence[Moved], sizes: Sequence[float], found: Changes, same: bool) -> dict[str, float]:
    """[µm] RMS in MuJoCo of the stale model, after an update from the second session, and after a full recalibration
    from as many rows as the first session had."""
    if not found.sets:
        return {}
    truth = drawn.truth(moved, sizes)
    data = drawn.second(moved, sizes)
    parts = [m.candidate.hypothesis if m.slip is None else m.slip.hypothesis for m in found.sets[0].members]
    plan = plans.make(drawn.robot, "random", pairs.FIRST, tools=pairs.tools(drawn.robot), seed=drawn.seed + 5)
    again = drawn.measured(moved, sizes, plan, drawn.seed + 6)
    try:
        models = (
            drawn.model,
            update(drawn.model, data, parts, same).model,
            identification.fit(again, drawn.robot).model,
        )
    except FitError:
        return {"landed_update": float("inf")}
    labels = ("landed_before", "landed_update", "landed_full")
    return {label: _landing(model, truth) for label, model in zip(labels, models, strict=True)}


def _landing(model: Model, truth: Any) -> float:
    grid = verify.grid_task(truth.robot, np.zeros(3))
    keep = np.unique(np.linspace(0, len(grid.position) - 1, TARGETS).astype(int))
    few = Conditions(grid.conditions.tool[keep], grid.conditions.payload[keep])
    seen = verify.run(model, truth, verify.Task(grid.position[keep], None, few), cycles=1, aligned=True)
    off = np.linalg.norm(seen.attained[0] - seen.task.position, axis=1)
    return float(np.sqrt(np.nanmean(off**2))) * 1e6


def year(seed: int, number: int) -> dict[str, Any]:
    """A year of weekly checks of 12 poses, noise as stated: alarms where nothing changes, then a rod that changes.

    Where the measuring frame may move a leg of a hexapod hides in it: its leg is asked about in an unchanged set-up.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(pairs.STREAM, number, 1)))
    kind = KINDS[number % 3]
    setup = "same" if kind == "hexapod" else SETUPS[(number // 3) % 3]
    drawn = replace(Pair.draw(kind, 12, setup, rng), stated=1.0)
    same, alarms = setup == "same", 0
    for week in range(WEEKS):
        drawn = _week(drawn, week)
        alarms += changes(drawn.model, drawn.second([], []), same, 0.05 / WEEKS).verdict is not Verdict.NOTHING
    mechanism = drawn.robot.mechanism
    legs = [f"{pairs.called(drawn.robot, i)}.zero" for i in range(len(mechanism.actuators))]
    rods = [f"l{r}" for r in mechanism.rods] if kind != "hexapod" else legs
    moved = pairs.part(drawn.robot, str(rng.choice(rods)), rng)
    unit = float(np.abs(moved.errors).max()) if moved.slip is None else float(np.abs(moved.slip).max())
    size, seen = ROD / unit, 0
    for check in (1, 2):
        drawn = _week(drawn, WEEKS + check)
        if changes(drawn.model, drawn.second([moved], [size]), same, 0.05 / WEEKS).verdict is not Verdict.NOTHING:
            seen = check
            break
    return {
        "kind": kind, "n": 12, "setup": setup, "what": "year", "alarms": alarms, "found_after": seen,
        "truth": [moved.name], "s": float(np.linalg.norm(drawn.visible([moved], [size])[0])),
    }  # fmt: skip


def _week(drawn: Pair, week: int) -> Pair:
    """The same robot and model, measured at other poses with other noise."""
    plan = plans.make(drawn.robot, "random", 12, tools=pairs.tools(drawn.robot), seed=drawn.seed + 100 + week)
    return drawn.later(plan, week + 1)
