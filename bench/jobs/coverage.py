"""How often 95 % intervals of a fit contain the truth, where the stated noise is right, wrong or not stated at all.

Robots with errors as large as the tolerances are measured with white noise, on poses of which some are repeated, and
fitted at level complete. Per robot the truth is compared with the 95 % ellipsoid of the TCP at poses that were not
measured, with two tools: d = S·(k − k̂) against the χ² distribution of 3 degrees of freedom, S = ∂TCP/∂k; and with the
95 % interval of every geometric parameter.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcalib import planning, prediction, rotation
from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.fitting import identification
from pcalib.fitting.identifiability import priors
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot

SIGMA_POS, SIGMA_ROT, SIGMA_JOINT = 20e-6, 60e-6, 30e-6
"""[m, rad, rad] noise of a laser tracker, and the joint repeatability of the last situation."""
POSES, REPEATED, TARGETS = 40, 20, 8
"""Poses of a data set, of which so many are measured twice, and places at which the TCP is asked for."""
SITUATIONS = {"right": 1.0, "half": 0.5, "double": 2.0, "unstated": None, "joints": 1.0}
"""Stated σ over the true one."""


@dataclass(frozen=True)
class Coverage:
    """Shares of 95 % intervals that hold the truth, over all robots of a situation."""

    situation: str
    robots: int
    parameters: float
    """Share of intervals of geometric parameters."""
    tcp: float
    """Share of ellipsoids of the TCP."""
    uncertain: float
    """1σ of the TCP share: robots are independent, places of one robot are not."""


def measured(robot: Robot, situation: str, seed: int) -> tuple[Model, Measurements]:
    """A robot with errors, and the data and model that its user has."""
    rng = np.random.default_rng([2106, seed])
    mechanism = robot.mechanism
    k = mechanism.nominal + priors(mechanism.units) * rng.standard_normal(len(mechanism.nominal))
    truth = Model(robot, k, "complete")
    q = planning.reachable(robot, POSES, rng).q
    q = np.concatenate([q, q[:REPEATED]])
    joints = SIGMA_JOINT * rng.standard_normal(q.shape) if situation == "joints" else 0.0
    tool = np.tile([0.0, 0.0, -0.1], (len(q), 1))
    p = prediction.predict(truth, q + joints, Conditions(tool, np.zeros(len(q))))
    ok = p.status == "ok"
    x = p.position + SIGMA_POS * rng.standard_normal((len(q), 3))
    R = rotation.exp(SIGMA_ROT * rng.standard_normal((len(q), 3))) @ p.rotation
    stated = SITUATIONS[situation]
    sigma = (None, None) if stated is None else (stated * SIGMA_POS, stated * SIGMA_ROT)
    data = Measurements.create(
        robot, q[ok], x[ok], R[ok], tool=tool[ok], pose_id=np.r_[np.arange(POSES), np.arange(REPEATED)][ok],
        sigma_pos=sigma[0], sigma_rot=sigma[1],
    )  # fmt: skip
    return truth, data


def inside(robot: Robot, situation: str, seed: int) -> tuple[float, float]:
    """Shares of parameters and of TCP ellipsoids of one robot that hold the truth."""
    from scipy.special import chdtri

    truth, data = measured(robot, situation, seed)
    found = identification.fit(data, robot)
    assert found.candidate.sigma is not None
    z = np.abs(found.candidate.k - truth.k) / found.candidate.sigma
    targets = planning.reachable(robot, TARGETS, np.random.default_rng([7, seed])).q
    held = 0
    basis = found.unknowns.basis
    C = basis @ found.covariance[: found.unknowns.n_geometry, : found.unknowns.n_geometry] @ basis.T
    for tool in (0.0, -0.3):
        conditions = Conditions.of(TARGETS, [0.0, 0.0, tool])
        p = prediction.predict(found.candidate, targets, conditions)
        S = prediction.geometry_columns(found.candidate, p, *prediction.closure_of(found.candidate, p))[:, :3]
        d = prediction.predict(truth, targets, conditions).position - p.position
        size = np.einsum("ni,nij,nj->n", d, np.linalg.inv(S @ C @ np.swapaxes(S, -1, -2)), d)
        held += int(np.sum(size < chdtri(3, 0.05)))
    return float(np.mean(z < 1.96)), held / (2 * TARGETS)


def study(robot: Robot, robots: int, seed: int = 0) -> list[Coverage]:
    """Coverage in every situation."""
    out = []
    for situation in SITUATIONS:
        shares = np.array([inside(robot, situation, seed * 100_000 + i) for i in range(robots)])
        mean, spread = shares.mean(axis=0), shares[:, 1].std(ddof=1) / np.sqrt(robots)
        out.append(Coverage(situation, robots, float(mean[0]), float(mean[1]), float(spread)))
    return out


def table(found: list[Coverage]) -> str:
    """The study in Markdown."""
    rows = [f"| {c.situation} | {c.robots} | {c.parameters:.1%} | {c.tcp:.1%} ± {c.uncertain:.1%} |" for c in found]
    return "\n".join(["| σ stated | robots | parameters inside | TCP ellipsoids inside |", "|---|---|---|---|", *rows])


def main(arguments: list[str]) -> None:
    """Print the study of the default Delta: `[ROBOTS [SEED]]`, else 200 robots of seeds 0 and 1."""
    robot = robots.load(Path(__file__).parents[2] / "models" / "delta.toml")
    count = int(arguments[0]) if arguments else 200
    for seed in [int(arguments[1])] if len(arguments) > 1 else [0, 1]:
        print(f"seed {seed}\n\n{table(study(robot, count, seed))}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
