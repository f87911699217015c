"""Data sets of the virtual robot, whose faults come from MuJoCo and never from pcalib's formulas."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from bench import faults, simulate
from bench import plan as plans
from bench import truth as truths
from bench.instrument import Instrument
from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.fitting import identification
from pcalib.model import Model

ROBOT = robots.load(Path(__file__).parents[2] / "models" / "delta.toml")
TOOLS = [np.array([0.0, 0.0, 0.0]), np.array([0.06, 0.0, -0.2])]


Case = tuple[Measurements, Model]


@lru_cache(maxsize=32)
def _measured(
    hidden: tuple[tuple[str, float], ...] = (),
    plan: str = "rich",
    n: int = 120,
    check: int = 30,
    seed: int = 1,
    kind: str = "pose",
) -> Case:
    """Data of a Delta with faults at multiples of their typical size, and the geometry fitted to it."""
    instrument = Instrument(sigma_pos=15e-6, sigma_rot=60e-6, kind=kind)
    errors = truths.draw_errors(ROBOT, 1e-4, np.radians(0.05), seed)
    made = truths.Truth(ROBOT, errors, instrument, tuple(faults.typical(ROBOT, name, scale) for name, scale in hidden))
    data = simulate.run(made, plans.make(ROBOT, plan, n, check=check, tools=TOOLS, seed=seed), seed).measurements
    return data, identification.fit(data, ROBOT).model


@pytest.fixture(scope="session")
def measured():
    """A function: (faults, plan, …) → measurements and the model fitted to them."""
    return _measured


@pytest.fixture(scope="session")
def robot():
    return ROBOT
