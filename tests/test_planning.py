"""Pose planning against brute force, against random poses, and within its limits."""

from itertools import combinations

import numpy as np
import pytest

from pcalib import planning
from pcalib.errors import InputError, ReachError
from pcalib.fitting.identifiability import priors
from pcalib.mechanics import kinematics
from pcalib.robot import parse

SIGMA = np.array([*[2e-5] * 3, *[np.radians(0.005)] * 3])
TOOLS = np.array([[0, 0, 0], [0, 0, -0.1], [0, 0, -0.3]])


def information(blocks, chosen):
    """log det(I + Σ BᵀB), straight from the definition."""
    some = blocks[list(chosen)].reshape(-1, blocks.shape[-1])
    return np.linalg.slogdet(np.eye(blocks.shape[-1]) + some.T @ some)[1]


@pytest.fixture(params=range(12))
def tiny(request):
    """Eight candidates of two readings and four parameters, of sizes that differ."""
    rng = np.random.default_rng(request.param)
    return rng.standard_normal((8, 2, 4)) * rng.uniform(0.1, 3, (8, 1, 1)) * rng.uniform(0.1, 3, 4)


def test_greedy_choice_is_that_of_brute_force(tiny):
    chosen: list[int] = []
    for _ in range(5):
        others = [c for c in range(8) if c not in chosen]
        chosen.append(max(others, key=lambda c: information(tiny, [*chosen, c])))
    assert planning.d_optimal(tiny, 5, exchanges=0).tolist() == chosen


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_exchanges_leave_nothing_to_gain(tiny, n):
    """No single exchange improves the choice; on such small cases it is the best of all, or within a few per cent."""
    chosen = planning.d_optimal(tiny, n, exchanges=20).tolist()
    value = information(tiny, chosen)
    for slot in range(n):
        for other in set(range(8)) - set(chosen):
            assert information(tiny, [*chosen[:slot], other, *chosen[slot + 1 :]]) <= value + 1e-9
    best = max(information(tiny, some) for some in combinations(range(8), n))
    assert value >= 0.97 * best
    if n in (1, 7):
        assert value == pytest.approx(best)
    assert len(set(chosen)) == n


def test_all_candidates_or_too_few(tiny):
    assert sorted(planning.d_optimal(tiny, 8)) == list(range(8))
    with pytest.raises(InputError, match="9 poses wanted of 8 candidates"):
        planning.d_optimal(tiny, 9)


def blocks_of(robot, q, tools, measured=(True,) * 6):
    """(C, r, 60) from S_C itself, not from the planner's own function."""
    mechanism = robot.mechanism
    pose = kinematics.forward(mechanism, mechanism.nominal, q).pose
    S = kinematics.sensitivity(mechanism, mechanism.nominal, q, pose, tools)
    return (S / SIGMA[:, None] * priors(mechanism.units))[:, list(measured)]


@pytest.mark.parametrize("rotations", [True, False], ids=["poses", "positions"])
def test_planned_poses_beat_random_ones(delta, rotations):
    """In information, and in what counts: the posterior variance of the TCP over the workspace."""
    measured = [True] * 3 + [rotations] * 3
    q, tools = planning.plan(delta, 40, tools=None if rotations else TOOLS, measured=measured, candidates=300)
    where = planning.reachable(delta, 100, np.random.default_rng(50)).q
    S = blocks_of(delta, where, np.array([0, 0, -0.1]))[:, :3] * SIGMA[:3, None]

    def figures(q, tools):
        B = blocks_of(delta, q, tools, measured).reshape(-1, 60)
        covariance = np.linalg.inv(np.eye(60) + B.T @ B)
        rms = np.sqrt(np.mean(np.sum(np.einsum("nij,jk,nik->ni", S, covariance, S), axis=1)))
        return np.linalg.slogdet(np.eye(60) + B.T @ B)[1], rms

    planned = figures(q, tools)
    rng = np.random.default_rng(1)
    others = [figures(planning.reachable(delta, 40, rng).q, tools[rng.permutation(40)]) for _ in range(20)]
    assert planned[0] > max(o[0] for o in others) + 5
    assert planned[1] < 0.9 * min(o[1] for o in others)


def test_plans_keep_to_joint_range_workspace_and_tools(delta):
    q, tools = planning.plan(delta, 30, tools=TOOLS, candidates=120, seed=3)
    pose = kinematics.forward(delta.mechanism, delta.mechanism.nominal, q).pose
    assert q.shape == (30, 3) and tools.shape == (30, 3)
    assert (q >= delta.joint_min).all() and (q <= delta.joint_max).all()
    assert (np.hypot(pose.x[:, 0], pose.x[:, 1]) <= 0.4 + 1e-9).all()
    assert (pose.x[:, 2] >= -0.925 - 1e-9).all() and (pose.x[:, 2] <= -0.675 + 1e-9).all()
    assert {tuple(t) for t in tools} <= {tuple(t) for t in TOOLS}
    assert len({(*a, *t) for a, t in zip(q.tolist(), tools.tolist(), strict=True)}) == 30
    again = planning.plan(delta, 30, tools=TOOLS, candidates=120, seed=3)
    assert np.array_equal(again[0], q) and np.array_equal(again[1], tools)


def test_the_instrument_decides_where_to_measure(delta):
    """Positions alone ask for several tools, the longest most often; full poses do not need them."""
    _, position = planning.plan(delta, 30, tools=TOOLS, measured=[True] * 3 + [False] * 3, candidates=150)
    assert len(np.unique(position, axis=0)) >= 2
    assert np.sum(position[:, 2] == -0.3) >= 10


def test_simple_levels_can_be_planned_for(delta):
    q, _ = planning.plan(delta, 12, level="classical", candidates=100)
    assert q.shape == (12, 3)


def test_progress_is_told(delta):
    said: list[float] = []
    planning.plan(delta, 10, candidates=50, tick=said.append)
    assert said == sorted(said) and 0 < said[0] and 0.3 < said[-1] <= 1


def test_a_workspace_out_of_reach_is_said(delta):
    text = delta.text.replace("= -925.0", "= -3925.0").replace("= -675.0", "= -3675.0")
    with pytest.raises(ReachError, match="only 0 of 30 poses found in the workspace of robot 'delta'"):
        planning.plan(parse(text), 10, candidates=10)
