"""Rows that `pcalib plan --to-tell` chooses: whether they separate effects as far as predicted, and how many it takes.

Every effect acts at its usual size, in robots whose geometry is drawn. `planned` measures 72 rows that were chosen to
tell effects apart, and 18 to check; `rich` measures 120 and 30, drawn at random under the same conditions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from bench import faults
from bench import plan as plans
from bench import truth as truths
from bench.commands import Commands
from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import in_words, robot
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.stage import SIGMA_ANGLE, SIGMA_LENGTH, Stage
from pcalib.diagnosis.diagnose import Diagnosis, diagnose
from pcalib.diagnosis.separation import TOLD, AtHand, Separation
from pcalib.diagnosis.separation import plan as choose

RICH = DESIGNS["rich"]
PLANNED = replace(RICH, rows=72, check=18)
"""Six tenths of the rows of a rich plan."""
WARM = (22.0 - plans.SWING, 22.0 + plans.SWING)
"""[°C] between which the temperatures of a rich plan swing."""
USUAL = {
    "drive_compliance": {"compliance_urad_Nm": 50.0},
    "rod_compliance": {"compliance_um_N": 0.05},
    "arm_bending": {"vertical_um_N": 0.2, "lateral_um_N": 0.2},
    "tool_bending": {"compliance_um_N": 2.0},
    "backlash": {"gap_urad": 300.0},
    "friction_hysteresis": {"per_load_urad_Nm": 10.0},
    "encoder_eccentricity": {"amplitude_urad": 200 * 2**0.5, "phase_deg": 45.0},
    "encoder_ovality": {"amplitude_urad": 100 * 2**0.5, "phase_deg": 22.5},
    "gear_ratio": {"error_ppm": 500.0},
    "gear_ripple": {"amplitude_urad": 200 * 2**0.5, "cycles_per_rev": 24.0, "phase_deg": 45.0},
    "thermal_arms": {"expansion_ppm_K": 15.0},
    "thermal_rods": {"expansion_ppm_K": 15.0},
    "thermal_base": {"expansion_ppm_K": 15.0},
    "joint_clearance": {"gap_um": 10.0},
    "base_drift": {"v_um_h": [100.0] * 3, "w_urad_h": [100.0] * 3},
}
"""Fault → its settings where every parameter of the effect of its name has its usual size."""
NEAR = 0.1
"""Relative difference of predicted and found separations."""


@cache
def planned() -> Separation:
    """Return rows for the default Delta, chosen for these effects."""
    hand = AtHand(tools=np.array(RICH.points), temperatures=WARM)
    sigma = np.repeat([RICH.sigma_pos, RICH.sigma_rot], 3)
    return choose(robot("delta"), PLANNED.rows, sigma, list(USUAL), hand)


def _stage(variant: str, seed: int) -> Stage:
    """Return a random Delta before the rows of a variant."""
    if variant == "rich":
        return Stage.draw(RICH, robot("delta"), seed)
    rows = planned()
    asked = Commands.of(rows.q, rows.conditions.tool, rows.conditions.payload, **rows.conditions.columns)
    plan = plans.Plan(asked, rows.pose_id, np.zeros(PLANNED.rows, bool), "to tell")
    plan = plans.with_checks(robot("delta"), plan, PLANNED.check, seed)
    errors = truths.draw_errors(robot("delta"), SIGMA_LENGTH, SIGMA_ANGLE, seed)
    return Stage(PLANNED, robot("delta"), errors, plan)


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    names = list(USUAL)
    for number in range(task.sets):
        name = names[(task.number * task.sets + number) % len(names)]
        there = _stage(task.variant, int(rng.integers(2**31)))
        fault = faults.make(there.robot, name, USUAL[name])
        data = there.measure([fault], there.land([fault]), int(rng.integers(2**31)))
        yield Set(there.robot, data, f"{name}, {task.variant}", {"name": name, "planned": task.variant == "planned"})


def beside(found: Diagnosis, name: str, other: str) -> float:
    """Return what a diagnosis finds of one effect that another cannot take up, in noise units; both in their simplest
    form."""
    candidates, screen = found.problem.candidates, found.problem.screen()

    def simplest(wanted: str) -> int:
        mine = [g for g, c in enumerate(candidates) if c.name == wanted]
        return min(mine, key=lambda g: len(candidates[g].scale))

    block = screen.allowing([simplest(other)])[simplest(name)]
    return float(np.sqrt(max(np.sum((block.T @ screen.y) ** 2) - block.shape[1], 0.0)))


def _judge(made: Set) -> Said:
    found = diagnose(made.model, made.data)
    name, rows = made.truth["name"], planned()
    i = rows.names.index(name)
    told = rows.matrix[i] >= TOLD
    hits = {}
    if told.all() and not (rows.alias[i] | rows.alias[:, i]).any():
        hits["single"] = found.established == (name,)
    figures = {}
    if made.truth["planned"]:
        for j in np.flatnonzero(told & (np.arange(len(told)) != i)):
            figures[rows.names[j]] = beside(found, name, rows.names[j]) / rows.matrix[i, j]
    if figures:
        middle = float(np.mean(list(figures.values())))
        # What is found of s noise units scatters by one.
        hits["predicted"] = abs(middle - 1) <= NEAR + 2 / float(np.median(rows.matrix[i][told]))
        figures["middle"] = middle
    return Said(in_words(found), hits, None, figures)


ROW = Row(
    "to_tell",
    {"planned": 75, "rich": 75},
    {
        "single": Bound("{} rows, effects of usual size: the right one is established alone", at_most=False),
        "predicted": Bound("{} rows: separations within 10 % of those found, and noise", 0.9, at_most=False),
    },
    _sets,
    _judge,
    per_task=5,
)
