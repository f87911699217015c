"""How often the truth lies within 95 % intervals: of the TCP at poses that were not measured, and of parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from bench import plan as plans
from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import KINDS, stage
from bench.jobs.hidden.design import DESIGNS, Design
from pcalib.data.measurement import Measurements
from pcalib.fitting import identification
from pcalib.fitting.linearisation import linearise
from pcalib.robot import Robot

SURE = 0.95
TOOL = np.array([0.0, 0.0, -0.1])
"""[m] measured by none of the points of a rich plan, among which it lies."""
RICH = DESIGNS["rich"]


@dataclass(frozen=True)
class _Variant:
    design: Design
    stated: float | None = 1.0
    """σ in the file over the σ there is; None: the file states none."""


VARIANTS = {
    "sigma_right": _Variant(RICH),
    "sigma_half": _Variant(RICH, 0.5),
    "sigma_double": _Variant(RICH, 2.0),
    "sigma_unstated": _Variant(replace(RICH, sigma_pos=45e-6, sigma_rot=180e-6), None),
    "joints_repeat_to_30_urad": _Variant(replace(RICH, instrument_settings={"sigma_joint": 30e-6})),
}


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    variant = VARIANTS[task.variant]
    kinds = tuple(k for k in KINDS if k not in ("linear_delta", "hexapod", "planar"))
    kind = kinds[task.number % len(kinds)]
    there = stage(variant.design, kind, rng)
    machine, commands = there.truth().machine(), there.plan.commands
    for _ in range(task.sets):
        seed = int(rng.integers(2**31))
        landing = there.reference
        if task.variant.startswith("joints"):
            miss = there.design.instrument().joint_noise(commands.q, "angle", seed, np.arange(len(commands)))
            landing = machine.run(commands, miss)
        data = there.measure((), landing, seed)
        if variant.stated is None:
            data = Measurements.create(
                there.robot, data.q, data.position, data.rotation, tool=data.tool, payload=data.payload,
                columns=data.columns, pose_id=data.pose_id, check=data.check,
            )  # fmt: skip
        else:
            data = replace(data, sigma=data.sigma * variant.stated)
        asked = plans.make(there.robot, "random", 1, seed=int(rng.integers(2**31))).commands.q
        yield Set(there.robot, data, kind, {"q": asked, "tcp": machine.land(asked, TOOL).tcp})


def _judge(made: Set) -> Said:
    assert isinstance(made.start, Robot)
    fit = identification.fit(made.data, made.start)
    q = made.truth["q"]
    point = Measurements.create(made.start, q, made.truth["tcp"], tool=TOOL, sigma_pos=1.0)
    seen = linearise(fit.model, point, fit.unknowns)
    error = seen.residual
    covariance = seen.jacobian @ fit.covariance @ seen.jacobian.T
    distance = float(error @ np.linalg.solve(covariance, error))
    return Said(f"{np.sqrt(distance):.2f} σ", {"inside": distance <= float(chi2.ppf(SURE, 3))})


ROW = Row(
    "coverage",
    dict.fromkeys(VARIANTS, 240),
    {
        "inside": Bound("{}: TCP within its 95 % ellipsoid", 0.92, at_most=False),
    },
    _sets,
    _judge,
    per_task=3,
)
