"""Every effect of the library, found by itself: protocol, linearity, basis, batch, and signs by hand."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcalib import effects, rotation, units
from pcalib import robot as robots
from pcalib.effects.base import Contribution, Situation
from pcalib.errors import EffectError
from pcalib.mechanics import kinematics, statics
from pcalib.mechanics.mechanism import Pose

ROBOT = robots.load(Path(__file__).parents[2] / "models" / "delta.toml")
CONTRACT = [
    "drive_compliance",
    "rod_compliance",
    "arm_bending",
    "tool_bending",
    "backlash",
    "friction_hysteresis",
    "encoder_eccentricity",
    "encoder_ovality",
    "gear_ratio",
    "gear_ripple",
    "thermal_arms",
    "thermal_rods",
    "thermal_base",
    "joint_clearance",
    "base_drift",
    "tracker_scale",
    "gravity_tilt",
]
VARIANTS = [(name, per) for name in effects.names() for per in effects.get(name).variants]


def make(seed=0, n=12):
    """A situation with everything in it: payload, tools, temperature, time, directions, drives that give way."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.5, 0.5, (n, 3))
    k = ROBOT.mechanism.nominal + 3e-4 * rng.standard_normal(60)
    pose = kinematics.forward(ROBOT.mechanism, k, q).pose
    columns = {"temp_arms": 20 + 9 * rng.standard_normal(n), "temp_rods": 20 + 5 * rng.standard_normal(n)}
    columns |= {"temp_base": 20 + 5 * rng.standard_normal(n), "time": 3600 * np.linspace(0, 2, n)}
    columns |= {f"dir{i + 1}": rng.integers(-1, 2, n).astype(float) for i in range(3)}
    partner = (effects.get("drive_compliance"), np.array([3e-5]))
    return Situation.at(
        ROBOT, k, q, pose, rng.uniform(-0.2, 0.2, (n, 3)), rng.uniform(0, 2, n), columns, partners=[partner]
    )


AT = make()


def arrays(contribution: Contribution):
    return {
        f.name: getattr(contribution, f.name) for f in fields(contribution) if getattr(contribution, f.name) is not None
    }


def assert_same(a, b, **tolerance):
    a, b = arrays(a), arrays(b)
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_allclose(a[name], b[name], err_msg=name, **tolerance)


def usual(effect, seed=1):
    return np.random.default_rng(seed).standard_normal(len(effect.parameters)) * [p.prior for p in effect.parameters]


def test_all_names_of_the_contract_are_there(own_tests):
    assert set(CONTRACT) <= set(effects.names()) <= {*CONTRACT, *own_tests}


@pytest.mark.parametrize(("name", "per"), VARIANTS)
class TestEvery:
    def test_is_frozen_and_named(self, name, per):
        effect = effects.get(name, per, ROBOT)
        assert effect.name == name and effect.title and effect.channels
        assert effects.parse(effect.spec, ROBOT) == effect
        with pytest.raises(AttributeError):
            effect.per = "other"  # pyright: ignore[reportAttributeAccessIssue]
        names = [p.name for p in effect.parameters]
        assert len(set(names)) == len(names)
        count = {"common": 1, "arm": 3, "rod": 6}[per]
        assert len(names) == count * len(effect.numbers())

    def test_parameters_have_unit_prior_and_range(self, name, per):
        for p in effects.get(name, per, ROBOT).parameters:
            assert units.factor(p.unit) > 0 and p.prior > 0
            assert p.low <= 0.0 < p.high and p.prior < p.high

    def test_zero_is_nothing(self, name, per):
        effect = effects.get(name, per, ROBOT)
        for value in arrays(effect.contribution(AT, np.zeros(len(effect.parameters)))).values():
            assert np.abs(value).max() == 0.0

    def test_something_comes_out_with_finite_values_in_its_channels(self, name, per):
        effect = effects.get(name, per, ROBOT)
        got = arrays(effect.contribution(AT, usual(effect)))
        assert got and set(got) <= set(effect.channels)
        shape = {"actuator": (12, 3), "rod": (12, 6), "elbow": (12, 6, 3), "plate": (12, 6, 3), "tool": (12, 3)}
        shape |= {"base": (12, 6), "sensor": (12, 3)}
        for channel, value in got.items():
            assert value.shape == shape[channel] and np.isfinite(value).all()
        assert max(np.abs(v).max() for v in got.values()) > 1e-8

    def test_basis_is_the_derivative(self, name, per):
        effect = effects.get(name, per, ROBOT)
        theta = usual(effect)
        columns = effect.basis(AT, theta)
        for j, parameter in enumerate(effect.parameters):
            h = 1e-4 * parameter.prior
            step = h * np.eye(len(theta))[j]
            slope = (effect.contribution(AT, theta + step) + effect.contribution(AT, theta - step).scaled(-1)).scaled(
                0.5 / h
            )
            for channel, value in arrays(slope).items():
                got = getattr(columns[j], channel)
                np.testing.assert_allclose(got, value, atol=1e-5 * np.abs(value).max() + 1e-12, rtol=1e-6)

    def test_linear_flag_is_true(self, name, per):
        effect = effects.get(name, per, ROBOT)
        a, b = usual(effect, 1), usual(effect, 2)
        total = effect.contribution(AT, a) + effect.contribution(AT, b)
        if effect.linear:
            assert_same(effect.contribution(AT, a + b), total, rtol=1e-9, atol=1e-15)
        else:
            with pytest.raises(AssertionError):
                assert_same(effect.contribution(AT, 30 * (a + b)), total.scaled(30), rtol=1e-9, atol=1e-15)

    def test_batch_is_loop(self, name, per):
        effect = effects.get(name, per, ROBOT)
        theta = usual(effect)
        whole = arrays(effect.contribution(AT, theta))
        for n in range(0, 12, 5):
            one = arrays(effect.contribution(AT.take(slice(n, n + 1)), theta))
            for channel in whole:
                np.testing.assert_allclose(one[channel][0], whole[channel][n], rtol=1e-9, atol=1e-18)

    def test_says_its_numbers(self, name, per):
        effect = effects.get(name, per, ROBOT)
        text = effect.describe(np.array([p.prior for p in effect.parameters]))
        assert text and "nan" not in text and "_" not in text

    def test_equal_separate_parameters_are_the_common_one(self, name, per):
        common, own = effects.get(name, None, ROBOT), effects.get(name, per, ROBOT)
        theta = usual(common)
        spread = np.repeat(theta, len(own.parameters) // len(theta))
        assert_same(own.contribution(AT, spread), common.contribution(AT, theta), rtol=1e-12)


# --- signs and sizes by hand -------------------------------------------------------------------------------------


def of(name, theta, at=AT, per=None):
    return effects.get(name, per, ROBOT).contribution(at, np.asarray(theta, float))


def loaded(payload, q=0.1):
    k, qq = ROBOT.mechanism.nominal, np.full((1, 3), q)
    pose = kinematics.forward(ROBOT.mechanism, k, qq).pose
    return Situation.at(ROBOT, k, qq, pose, 0.0, payload)


def plate_height(at, contribution):
    return kinematics.forward(ROBOT.mechanism, at.k, at.q, at.pose, contribution.deviation).pose.x[0, 2]


@pytest.mark.parametrize(
    ("name", "theta"), [("drive_compliance", [5e-5]), ("rod_compliance", [1e-7]), ("arm_bending", [1e-6, 0])]
)
def test_compliance_lets_the_plate_down(name, theta):
    light, heavy = loaded(0.0), loaded(2.0)
    drop = [plate_height(at, of(name, theta, at)) - at.pose.x[0, 2] for at in (light, heavy)]
    assert drop[1] < drop[0] < 0


def test_drive_and_rod_compliance_by_hand():
    assert_same(of("drive_compliance", [2e-5]), Contribution(actuator=2e-5 * AT.torque))
    per_arm = of("drive_compliance", [0, 1e-5, 0], per="arm").actuator
    np.testing.assert_allclose(per_arm, [0, 1e-5, 0] * AT.torque)
    assert_same(of("rod_compliance", [1e-7]), Contribution(rod=1e-7 * AT.tension))
    per_rod = of("rod_compliance", np.arange(6) * 1e-7, per="rod").rod
    np.testing.assert_allclose(per_rod, np.arange(6) * 1e-7 * AT.tension)
    of_arm = of("rod_compliance", [0, 0, 1e-7], per="arm").rod
    np.testing.assert_allclose(of_arm[:, 4:], 1e-7 * AT.tension[:, 4:])
    assert np.abs(of_arm[:, :4]).max() == 0


def test_arm_bending_vertical_at_the_horizontal_arm():
    """q = 0: all is along z; two equal elbow loads F/2 and the arm's even weight: δ_z = c·(F + 3/8·W)."""
    at = loaded(1.0, q=0.0)
    got = of("arm_bending", [1e-6, 0.0], at).elbow[0]
    F = at.elbow_force[0, :2, 2].sum()
    np.testing.assert_allclose(got[:2, 2], 1e-6 * (F - 9.81 * 0.375), rtol=1e-9)
    assert np.abs(got[:, :2]).max() < 1e-15 and F < 0


def test_arm_bending_lateral_is_a_cantilever_by_quadrature():
    """Elbow displacement and slope from integrating the bending moment along the arm, EI = a³/3c."""
    at = AT.take(slice(0, 1))
    c, a = 1e-6, 0.35
    k = ROBOT.mechanism.nominal
    at = Situation.at(ROBOT, k, at.q, kinematics.forward(ROBOT.mechanism, k, at.q).pose, at.tool, at.payload)
    got = of("arm_bending", [0.0, c], at).elbow[0, :2]
    theta = np.radians(60)
    u = np.array([np.cos(theta), np.sin(theta), 0])
    v = np.array([-np.sin(theta), np.cos(theta), 0])
    e = np.cos(at.q[0, 0]) * v + np.sin(at.q[0, 0]) * np.array([0, 0, 1.0])
    up = np.cross(u, e)
    force = at.elbow_force[0, :2]
    offset = np.array([-0.05, 0.05])[:, None] * u
    f = force.sum(axis=0) @ -u  # along −u, where turning about `up` moves the tip
    m = np.cross(offset, force).sum(axis=0) @ up
    EI = a**3 / (3 * c)
    y = (np.arange(20000) + 0.5) / 20000 * a
    curvature = (f * (a - y) + m) / EI
    slope = curvature.sum() * a / 20000
    tip = (curvature * (a - y)).sum() * a / 20000
    wanted = -tip * u + np.cross(slope * up, offset)
    np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-15)


def test_tool_bending():
    still = Pose(np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 0)))
    at = replace(AT.take(slice(0, 1)), pose=still, tool=np.array([[0.0, 0, -0.3]]), payload=np.array([2.0]))
    assert np.abs(of("tool_bending", [1e-6], at).tool).max() < 1e-18  # hangs straight
    side = replace(at, tool=np.array([[0.2, 0.0, 0.0]]))
    np.testing.assert_allclose(of("tool_bending", [1e-6], side).tool[0], [0, 0, -1e-6 * 8 * 2 * 9.81])
    tilted = replace(at, pose=replace(still, R=rotation.exp(np.array([[0.01, 0, 0]]))))
    # tool end swings to +y (plate tilts about x), weight pulls it further down: −z in base, so −y·sin in plate axes
    assert of("tool_bending", [1e-6], tilted).tool[0, 1] < 0


def test_backlash_lags_behind_the_motion_and_follows_the_load():
    got = of("backlash", [4e-4]).actuator
    for n in range(12):
        for i in range(3):
            d = AT.columns[f"dir{i + 1}"][n]
            want = -2e-4 * d if d else 2e-4 * np.sign(AT.torque[n, i])
            assert got[n, i] == want
    silent = replace(AT, columns={})
    np.testing.assert_array_equal(of("backlash", [4e-4], silent).actuator, 2e-4 * np.sign(AT.torque))


def test_friction_hysteresis():
    got = of("friction_hysteresis", [1e-5]).actuator
    np.testing.assert_allclose(got[:, 1], -1e-5 * AT.columns["dir2"] * np.abs(AT.torque[:, 1]))


def test_encoder_and_gear():
    q = AT.q
    np.testing.assert_allclose(of("encoder_eccentricity", [1e-4, 2e-4]).actuator, 1e-4 * np.sin(q) + 2e-4 * np.cos(q))
    np.testing.assert_allclose(
        of("encoder_ovality", [1e-4, 2e-4]).actuator, 1e-4 * np.sin(2 * q) + 2e-4 * np.cos(2 * q)
    )
    np.testing.assert_allclose(of("gear_ratio", [1e-3]).actuator, 1e-3 * q)
    ripple = effects.parse("gear_ripple@30", ROBOT).contribution(AT, np.array([1e-4, 2e-4])).actuator
    np.testing.assert_allclose(ripple, 1e-4 * np.sin(30 * q) + 2e-4 * np.cos(30 * q))


def test_gear_ripple_takes_its_cycles_from_the_robot_file():
    robot = replace(ROBOT, drive={"ripple_per_turn": [24, 48]})
    effect = effects.get("gear_ripple", None, robot)
    assert effect.spec == "gear_ripple@24+48" and len(effect.parameters) == 4
    assert len(effects.parse("gear_ripple:arm@24+48", ROBOT).parameters) == 12


@pytest.mark.parametrize("part", ["arms", "rods", "base"])
def test_thermal_growth_is_a_scaled_parameter(part):
    """The deviation equals closing the loops with scaled a, l or p."""
    alpha, warm = 2.36e-5, 10.0
    n = 4
    k = ROBOT.mechanism.nominal
    pose = kinematics.forward(ROBOT.mechanism, k, AT.q[:n]).pose
    at = Situation.at(ROBOT, k, AT.q[:n], pose, columns={"temp": np.full(n, 20 + warm)})
    got = kinematics.forward(ROBOT.mechanism, k, at.q, pose, of(f"thermal_{part}", [alpha], at).deviation).pose
    scaled = k.copy()
    head = {"arms": "a", "rods": "l", "base": "p"}[part]
    for i, name in enumerate(ROBOT.mechanism.parameters):
        if name.startswith(head):
            scaled[i] *= 1 + alpha * warm
    want = kinematics.forward(ROBOT.mechanism, scaled, at.q).pose
    np.testing.assert_allclose(got.x, want.x, atol=1e-11)
    assert np.abs(got.x - pose.x).max() > 1e-5


def test_joint_clearance_lengthens_pulled_rods():
    got = of("joint_clearance", [1e-5]).rod
    np.testing.assert_array_equal(got, 5e-6 * np.sign(AT.tension))
    assert plate_height(loaded(1.0), of("joint_clearance", [1e-5], loaded(1.0))) < loaded(1.0).pose.x[0, 2]


def test_base_drift_is_a_twist_times_time():
    got = of("base_drift", [1e-7, 0, 0, 0, 0, 2e-8]).base
    np.testing.assert_allclose(got[:, 0], 1e-7 * AT.columns["time"])
    np.testing.assert_allclose(got[:, 5], 2e-8 * AT.columns["time"])


def test_tracker_scale_is_about_the_measuring_origin():
    np.testing.assert_allclose(of("tracker_scale", [1e-5]).sensor, 1e-5 * AT.pose.tcp(AT.tool))
    moved = replace(AT, position=AT.pose.tcp(AT.tool) + 2.0)
    np.testing.assert_allclose(of("tracker_scale", [1e-5], moved).sensor, 1e-5 * moved.position)


def test_gravity_tilt_is_the_change_of_the_partners():
    theta = np.array([0.01, -0.02])
    g = rotation.exp(np.array([0.01, -0.02, 0.0])) @ ROBOT.gravity
    tilted = statics.loads(ROBOT.mechanism, AT.k, AT.q, AT.pose, ROBOT.mass, g, AT.tool, AT.payload)
    got = of("gravity_tilt", theta).actuator
    np.testing.assert_allclose(got, 3e-5 * (tilted.torque - AT.torque), rtol=1e-9, atol=1e-15)
    assert arrays(of("gravity_tilt", theta, replace(AT, partners=()))) == {}


def test_messages():
    with pytest.raises(EffectError, match="did you mean 'backlash'"):
        effects.get("backlsh")
    with pytest.raises(EffectError, match="no variant 'rod'"):
        effects.get("backlash", "rod")
    with pytest.raises(EffectError, match="column 'time' is needed"):
        of("base_drift", np.ones(6), replace(AT, columns={}))
    with pytest.raises(EffectError, match="cycles per turn"):
        effects.parse("gear_ripple@many")


def test_missing_columns():
    drift, arms = effects.get("base_drift"), effects.get("thermal_arms")
    assert effects.missing(drift, {}) == ["time"]
    assert effects.missing(drift, {"time": np.array([0.0, np.nan])}) == ["time"]
    assert effects.missing(arms, {"temp": np.zeros(3)}) == []


ANSWERS = {"drive_compliance": -1, "rod_compliance": -1, "arm_bending": -1, "tool_bending": -1}
"""Effects that are linear in loads."""
SIGNS = {"backlash": -1, "joint_clearance": -1, "friction_hysteresis": 1}
"""And those that go by a load's sign or size: what becomes of them where every load is turned round."""


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(CONTRACT))
def test_mirrored_gravity_and_payload_scale_loads_only(seed, name):
    """Gravity turned round turns all loads round, payload adds to them; effects that do not answer to load stay."""
    columns = {c: v for c, v in AT.columns.items() if name != "backlash" or not c.startswith("dir")}
    base = replace(AT, columns=columns, partners=()).take(slice(0, 6))
    effect = effects.get(name, None, ROBOT)
    theta = usual(effect, seed)

    def added(gravity, more=0.0):
        return arrays(effect.contribution(replace(base, payload=base.payload + more).under(gravity), theta))

    g = ROBOT.gravity
    plain, mirrored, one, two = added(g), added(-g), added(g, 1.0), added(g, 2.0)
    for channel, value in plain.items():
        size = np.abs(two[channel]).max()
        turned = ANSWERS.get(name, SIGNS.get(name, 1)) * value
        np.testing.assert_allclose(mirrored[channel], turned, rtol=0, atol=1e-9 * size)
        if name not in SIGNS:
            np.testing.assert_allclose(two[channel] - value, 2 * (one[channel] - value), rtol=0, atol=1e-9 * size)
            assert np.array_equal(one[channel], value) == (name not in ANSWERS)
