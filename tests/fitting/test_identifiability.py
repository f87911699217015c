"""What data can say: ranks of the Delta, true sentences about what is not seen, indices of hand-made spectra."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import planning, prediction, rotation
from pcalib.fitting import identifiability
from pcalib.fitting.identifiability import THRESHOLD, analyse, priors
from pcalib.fitting.sufficiency import expected_rank
from pcalib.mechanics import kinematics
from pcalib.model import Frame, Model
from pcalib.prediction import Conditions

SIGMA = np.array([*[2e-5] * 3, *[np.radians(0.005)] * 3])


@pytest.fixture(scope="module")
def q(delta):
    return planning.reachable(delta, 40, np.random.default_rng(3)).q


def design(delta, q, tools=(0.0,), components=range(6), frame=False):
    """Whitened S_C (M, 60) at nominal of 40 poses with each tool, and the columns of the frame (M, 9) or None."""
    nominal = replace(Model.nominal(delta), frame=Frame() if frame else None)
    rows, nuisance = [], []
    for h in tools:
        p = prediction.predict(nominal, q, Conditions.of(len(q), [0, 0, -h]))
        S = kinematics.sensitivity(delta.mechanism, delta.mechanism.nominal, q, p.pose, np.array([0, 0, -h]))
        rows.append((S / SIGMA[:, None])[:, list(components)].reshape(-1, 60))
        if frame:
            F = prediction.frame_columns(nominal, p) / SIGMA[:, None]
            nuisance.append(F[:, list(components)].reshape(-1, 9))
    return np.vstack(rows), np.vstack(nuisance) if frame else None


POSITION = (0, 1, 2)
RANKS = {
    "full pose": ({}, 42),
    "position": ({"components": POSITION}, 38),
    "position, 300 mm tool": ({"components": POSITION, "tools": (0.3,)}, 38),
    "z only": ({"components": (2,)}, 35),
    "position, three tools": ({"components": POSITION, "tools": (0.0, 0.1, 0.3)}, 41),
    "full pose, frame unknown": ({"frame": True}, 36),
    "position, frame unknown": ({"components": POSITION, "frame": True}, 32),
    "position, three tools, frame unknown": ({"components": POSITION, "tools": (0.0, 0.1, 0.3), "frame": True}, 35),
}


@pytest.mark.parametrize(("options", "rank"), RANKS.values(), ids=RANKS)
def test_ranks_at_nominal(delta, q, options, rank):
    """Bare ranks: singular values that are zero but for rounding, whatever noise and priors."""
    J, nuisance = design(delta, q, **options)
    prior = priors(delta.mechanism.units)
    s = np.linalg.svd(identifiability.without(J, nuisance) * prior, compute_uv=False)
    assert s[rank - 1] / s[rank] > 1e4
    assert s[rank] / s[0] < 1e-12


def test_the_threshold_lies_in_the_gap_of_the_full_pose_spectrum(delta, perturb, q):
    """210 … 0.5, then nothing at nominal; perturbed geometry lifts the rest by the square of its errors."""
    mechanism = delta.mechanism
    for k, floor in ((mechanism.nominal, 1e-12), (perturb(0), 2e-3), (perturb(0, 0.5, 0.2), THRESHOLD)):
        pose = kinematics.forward(mechanism, k, q).pose
        J = (kinematics.sensitivity(mechanism, k, q, pose) / SIGMA[:, None]).reshape(-1, 60)
        found = analyse(J, priors(mechanism.units), mechanism.parameters)
        assert found.n_identified == len(found.base) == 42 and len(found.dependent) == 18
        assert found.ratio[41] > 0.3 and found.ratio[42] < floor
        assert np.all(np.diff(found.ratio) <= 0)


def test_expected_ranks_are_those_that_a_fit_needs(delta):
    """What `fit` expects of readings, by the threshold of 1 % of the prior."""
    full, position = (True,) * 6, (True,) * 3 + (False,) * 3

    def expected(*kinds, frame=False, level="complete"):
        keep = (True,) * len(delta.mechanism.levels[level].columns)
        return expected_rank(delta, level, keep, kinds, tuple(SIGMA), frame)

    assert expected((full, (0.0, 0.0, 0.0))) == 42
    assert expected((full, (0.0, 0.0, 0.0)), frame=True) == 36
    assert expected((position, (0.0, 0.0, 0.0))) in (37, 38)
    assert expected(*((position, (0.0, 0.0, -h)) for h in (0.0, 0.1, 0.3))) in (40, 41)
    assert expected((position, (0.0, 0.0, 0.0)), level="classical") == 9
    assert expected((position, (0.0, 0.0, 0.0)), level="model24") == 24


@pytest.mark.parametrize("components", [range(6), POSITION], ids=["full pose", "position"])
def test_dependent_parameters_leave_no_trace_in_the_stated_combination(delta, q, components):
    """Moving a dependent parameter by 1 and its base partners by minus the stated factors leaves readings unchanged."""
    mechanism = delta.mechanism
    J, _ = design(delta, q, components=components)
    found = analyse(J, priors(mechanism.units), mechanism.parameters)
    assert set(found.base) | set(found.dependent) == set(mechanism.parameters)
    for name, mix in found.dependent.items():
        assert name not in found.base and set(mix) <= set(found.base)
        alone = J[:, mechanism.index(name)]
        rest = alone - sum((factor * J[:, mechanism.index(other)] for other, factor in mix.items()), 0 * alone)
        assert np.linalg.norm(rest) < 0.01 * np.linalg.norm(alone)  # partners of less than 0.1 % are not named
        if len(mix) <= 6:
            assert np.linalg.norm(rest) < 1e-9 * np.linalg.norm(alone)
    assert sum(len(mix) <= 6 for mix in found.dependent.values()) >= 9
    assert len(found.sentences()) == len(found.dependent)


@pytest.mark.parametrize("least", [0.3, 0.7])
def test_companions_are_the_main_part_counted_in_tolerances(delta, q, least):
    mechanism = delta.mechanism
    J, _ = design(delta, q)
    found = analyse(J, priors(mechanism.units), mechanism.parameters)
    prior = dict(zip(mechanism.parameters, priors(mechanism.units), strict=True))
    companions = found.companions(least)
    assert list(companions) == list(found.dependent)
    for name, (main, rest) in companions.items():
        size = {other: abs(value) / prior[other] for other, value in found.dependent[name].items()}
        left = set(size) - set(main)
        assert main and rest == len(left) and main.items() <= found.dependent[name].items()
        assert min(size[o] for o in main) >= least * max(size.values()) > max((size[o] for o in left), default=0)
    assert any(rest for _, rest in companions.values())


def test_the_null_directions_of_the_paper(delta, q):
    """Six of a.x ≡ bp along the axis, three of β·u ≡ a.z of both rods, as parameters in words and as vectors."""
    mechanism = delta.mechanism
    J, _ = design(delta, q)
    found = analyse(J, priors(mechanism.units), mechanism.parameters)
    scale = priors(mechanism.units)
    for i, azimuth in enumerate(delta.dimensions["axis_azimuth"], 1):
        u = np.array([np.cos(azimuth), np.sin(azimuth), 0])
        for direction in (
            {f"a{i}1.x": 1.0} | {f"b{i}1.{c}": u[n] for n, c in enumerate("xyz")},
            {f"a{i}2.x": 1.0} | {f"b{i}2.{c}": u[n] for n, c in enumerate("xyz")},
            {f"beta{i}.{c}": u[n] for n, c in enumerate("xyz")}
            | {f"a{i}{j}.z": -delta.dimensions["arm_length"] for j in (1, 2)},
        ):
            v = np.zeros(60)
            for name, value in direction.items():
                v[mechanism.index(name)] = value
            assert np.linalg.norm(J @ v) < 1e-9 * np.linalg.norm(J) * np.linalg.norm(v)
            # and within the null space that the analysis gives
            null = found.directions[:, 42:]
            w = v / scale
            assert np.linalg.norm(w - null @ (null.T @ w)) < 1e-6 * np.linalg.norm(w)


def test_spectrum_and_base_of_a_design_done_by_hand():
    """Three parameters, two readings: c = 2·a, b alone, and one that is never seen."""
    J = np.array([[3.0, 0, 6.0, 0], [0, 0.5, 0, 0]])
    found = analyse(J, np.array([1.0, 2.0, 0.75, 1.0]), ["a", "b", "c", "d"])
    np.testing.assert_allclose(found.ratio, [np.hypot(3, 4.5), 1, 0, 0])
    assert found.base == ("c", "b")
    assert found.dependent == {"a": {"c": 0.5}, "d": {}}  # in the parameters' own units, whatever the priors
    assert set(found.sentences()) == {"a cannot be told from +0.5·c", "d leaves no trace in these data"}
    unlike = analyse(J, np.array([1.0, 2.0, 0.75, 1.0]), ["a", "b", "c", "d"], units=["rad", "m", "m", "m"])
    assert "a cannot be told from +0.5 m/rad·c" in unlike.sentences()
    np.testing.assert_allclose(np.abs(found.directions[:, 0]), np.array([3, 0, 4.5, 0]) / np.hypot(3, 4.5), atol=1e-12)
    np.testing.assert_allclose(found.directions.T @ found.directions, np.eye(4), atol=1e-12)


def test_priors_decide_in_their_own_units():
    """The same design in millimetres: ratios and base stay, factors change unit."""
    J = np.array([[3.0, 0, 6.0], [0, 0.5, 1.0], [0, 0, 2.0]])
    prior = np.array([1e-4, 1e-3, 1e-4])
    unit = np.array([1e3, 1.0, 1.0])
    a, b = (analyse(J / u / 1e-5, prior * u, ["a", "b", "c"]) for u in (np.ones(3), unit))
    np.testing.assert_allclose(a.ratio, b.ratio)
    assert a.base == b.base


def test_no_readings_at_all():
    found = analyse(np.zeros((4, 2)), np.ones(2), ["a", "b"])
    assert found.n_identified == 0 and found.base == ()
    assert found.sentences() == ["a leaves no trace in these data", "b leaves no trace in these data"]


def test_nuisance_is_projected_out():
    rng = np.random.default_rng(0)
    J, nuisance = rng.standard_normal((30, 5)), rng.standard_normal((30, 2))
    nuisance = np.hstack([nuisance, nuisance[:, :1], np.zeros((30, 1))])  # redundant and empty columns change nothing
    J[:, 4] = nuisance[:, 0] * 3
    found = analyse(J, np.ones(5), list("abcde"), nuisance)
    assert found.n_identified == 4 and found.dependent == {"e": {}}
    full = np.hstack([J[:, :4], nuisance[:, :2]])
    sigma = np.sqrt(np.diag(np.linalg.inv(full.T @ full)))[:4]
    left = identifiability.without(J[:, :4], nuisance)
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(left.T @ left))), sigma)


def test_frame_columns_are_rigid_motions_of_the_robot(delta, q):
    """Six directions of geometry move the whole robot: displaced base points and plate points do what a frame does."""
    mechanism = delta.mechanism
    v, w = np.array([1e-4, -2e-4, 3e-4]), np.array([1e-4, 2e-4, -1e-4])
    k = mechanism.nominal.copy()
    for i in (1, 2, 3):
        p, beta = ([mechanism.index(f"{name}{i}.{c}") for c in "xyz"] for name in ("p", "beta"))
        k[p] = v + rotation.exp(w) @ mechanism.nominal[p]
        k[beta] = w
    nominal, moved = (kinematics.forward(mechanism, g, q).pose for g in (mechanism.nominal, k))
    assert np.abs(moved.x - (nominal.x @ rotation.exp(w).T + v)).max() < 1e-12
    assert np.abs(moved.R - rotation.exp(w) @ nominal.R).max() < 1e-12
