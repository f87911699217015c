"""What many tests need: the default Delta, robots with random errors, and measurements by pcalib's own kinematics."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import planning, prediction, rotation
from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot

# A run started in the background ignores Ctrl-C, and so would every program that it starts and interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SLOW = frozenset((Path(__file__).parent / "slow.txt").read_text().split())
"""Files whose fixtures are slow, and further tests that are, as scripts/test --measure found them when it last ran."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if not SLOW.isdisjoint((item.nodeid.partition("::")[0], item.nodeid.partition("[")[0])):
            item.add_marker("slow")


SIGMA_POS, SIGMA_ROT = 2e-5, np.radians(0.005)


@pytest.fixture(scope="session")
def own_tests() -> set[str]:
    """What has a test file of its own, by name: a new effect, fault or kind brings one and is in no other's table."""
    return {file.stem.removeprefix("test_") for file in Path(__file__).parent.rglob("test_*.py")}


@pytest.fixture(scope="session")
def delta() -> Robot:
    """The default robot."""
    return robots.load(Path(__file__).parents[1] / "models" / "delta.toml")


@pytest.fixture(scope="session")
def perturb(delta) -> Callable[..., np.ndarray]:
    """perturb(seed, mm=0.1, deg=0.05) → raw parameters k (60,) with normal errors of that size."""

    def make(seed: int, mm: float = 0.1, deg: float = 0.05) -> np.ndarray:
        mechanism = delta.mechanism
        size = np.where(np.array(mechanism.units) == "rad", np.radians(deg), 1e-3 * mm)
        return mechanism.nominal + size * np.random.default_rng(seed).standard_normal(len(size))

    return make


@pytest.fixture(scope="session")
def measure() -> Callable[..., Measurements]:
    """Measurements of a model at random reachable poses, in memory; `noise` and `stated` in units of the usual σ."""

    def make(
        model: Model,
        n: int = 40,
        seed: int = 0,
        *,
        tools: tuple[float, ...] | np.ndarray = (0.0,),
        noise: float = 1.0,
        stated: float = 1.0,
        rotations: bool = True,
        q: np.ndarray | None = None,
        payload: np.ndarray | None = None,
        columns: dict[str, np.ndarray] | None = None,
        check: np.ndarray | None = None,
    ) -> Measurements:
        rng = np.random.default_rng(seed)
        if q is None:
            q = planning.reachable(model.robot, n, rng).q
        n = len(q)
        tools = np.asarray(tools, float)
        if tools.ndim == 1:  # lengths below the plate
            tools = np.stack([0 * tools, 0 * tools, -tools], axis=-1)
        tool = tools[np.arange(n) % len(tools)]
        conditions = Conditions(tool, np.zeros(n) if payload is None else payload, dict(columns or {}))
        p = prediction.predict(model, q, conditions)
        assert (p.status == "ok").all()
        x = p.position + noise * SIGMA_POS * rng.standard_normal((n, 3))
        R = rotation.exp(noise * SIGMA_ROT * rng.standard_normal((n, 3))) @ p.rotation
        data = Measurements.create(
            model.robot, q, x, R if rotations else None, tool=tool, payload=conditions.payload, columns=columns,
            check=check, sigma_pos=stated * SIGMA_POS, sigma_rot=stated * SIGMA_ROT if rotations else None,
            frame="base" if model.frame is None else "tracker",
        )  # fmt: skip
        return replace(data, lines=np.arange(2, n + 2))

    return make
