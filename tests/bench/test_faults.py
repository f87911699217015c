"""Every fault against an estimate that shares nothing with the bench: virtual work, beam theory, closed forms.

Nor with `pcalib`, but for names and values: the Delta's closure is written out and solved below, with rotations of
SciPy, and forces come from differences of the potential energy of all masses. Each deflection must agree within 1 % of
its RMS over the poses; what remains is of second order (loads at the deflected instead of the rigid pose).
"""


from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench import faults, random_laws, simulate
from bench import plan as plans
from bench import truth as truths
from bench.commands import Commands
from bench.instrument import Instrument
from bench.kinds import MODELS
from bench.machine import Machine
from bench.plan import Plan
from bench.random_laws import Law, Term
from pcalib import robot as robots

ROBOT = robots.load(MODELS / "delta.toml")
MECHANISM, MASS = ROBOT.mechanism, ROBOT.mass
K = MECHANISM.nominal + np.where(np.array(MECHANISM.units) == "rad", 2e-3, 3e-4) * np.random.default_rng(5).uniform(
    -1, 1, len(MECHANISM.nominal)
)
N = 16
RNG = np.random.default_rng(11)
Q = RNG.uniform(-0.85, 0.3, (N, 3))
TOOL = np.where(np.arange(N)[:, None] % 2, [0.06, -0.04, -0.1], [0.0, 0.02, -0.3])
PAYLOAD = np.tile([0.0, 1.0, 2.5, 1.5], N // 4)
DIRECTION = RNG.choice([-1.0, 1.0], (N, 3))
TIME = np.sort(RNG.uniform(0, 7200, N))
TIME[0] = 0.0
WARM = {f"temp_{part}": RNG.uniform(12, 32, N) for part in ("arms", "rods", "base")}
COMMANDS = Commands.of(Q, TOOL, PAYLOAD, time=TIME, **WARM, **{f"dir{i + 1}": DIRECTION[:, i] for i in range(3)})


def land(*present, commands=COMMANDS):
    landing = Machine(ROBOT, K, present).run(commands)
    assert landing.ok.all()
    return landing


RIGID = land()


def typical(name, scale=1.0):
    return faults.typical(ROBOT, name, scale)


ESTIMATED = set()
"""Faults that a test of this file estimates by other means."""


def estimates(*names):
    ESTIMATED.update(names)
    return lambda test: test


# -- the independent side ----------------------------------------------------------------------------------------

ARM = np.repeat(np.arange(3), 2)
VALUE = dict(zip(MECHANISM.parameters, K, strict=True))
RODS = [f"{i}{j}" for i in (1, 2, 3) for j in (1, 2)]


def turned(vector):
    """Rotation matrices (…, 3, 3) of rotation vectors (…, 3)."""
    vector = np.asarray(vector, float)
    return Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix().reshape(*vector.shape, 3)


def about(axis, angle):
    return turned(np.asarray(angle)[..., None] * np.array(axis, float))


def points(letter, tags):
    return np.array([[VALUE[f"{letter}{tag}.{axis}"] for axis in "xyz"] for tag in tags])


E0 = turned(points("beta", "123")) @ about([0, 0, 1], np.radians([60, 180, 300]))
"""(3, 3, 3) arm frames at q = 0, base axes."""


@dataclass(frozen=True)
class Delta:
    """The Delta for the N commands, by the words of docs/robots.md; what deviates is added. All in SI."""

    q: np.ndarray
    p: np.ndarray
    a: np.ndarray
    b: np.ndarray
    length: np.ndarray
    elbow: np.ndarray
    """Further displacement of the elbow points, base axes."""

    @property
    def elbows(self):
        """(N, 6, 3) in the base frame."""
        arm = E0 @ about([1, 0, 0], self.q)  # (N, 3, 3, 3)
        return self.p[..., ARM, :] + (arm[:, ARM] @ self.a[..., None])[..., 0] + self.elbow

    def pose(self):
        """Plate position (N, 3) and orientation (N, 3, 3): Newton on |A − B| = l from a level plate."""
        A = self.elbows
        x, R = np.tile([0.0, 0.0, -0.8], (N, 1)), np.tile(np.eye(3), (N, 1, 1))
        for _ in range(12):
            b = (R[:, None] @ self.b[..., None])[..., 0]
            rod = x[:, None] + b - A
            far = np.linalg.norm(rod, axis=2)
            n = rod / far[..., None]
            J = np.concatenate([n, np.cross(b, n)], axis=2)
            step = np.linalg.solve(J, (self.length - far)[..., None])[..., 0]
            x, R = x + step[:, :3], turned(step[:, 3:]) @ R
        assert np.abs(step).max() < 1e-13 and (x[:, 2] < A[..., 2].min(axis=1)).all() and (R[:, 2, 2] > 0.9).all()
        return x, R

    def tcp(self, tool=TOOL):
        x, R = self.pose()
        return x + (R @ np.asarray(tool)[..., None])[..., 0]

    def masses(self):
        """[(mass, centre of mass (N, 3))] of arms, rods, plate and payload."""
        x, R = self.pose()
        arms = self.p + E0 @ about([1, 0, 0], self.q) @ [0, MASS["arm_com"], 0]
        rods = 0.5 * (self.elbows + x[:, None] + (R[:, None] @ self.b[..., None])[..., 0])
        out = [(MASS["arm"], arms[:, i]) for i in range(3)] + [(MASS["rod"], rods[:, r]) for r in range(6)]
        return [*out, (MASS["plate"], x), (PAYLOAD, x + (R @ TOOL[..., None])[..., 0])]

    def energy(self, g=ROBOT.gravity):
        """Potential energy of the weights, (N,) [J]."""
        return -sum(m * (r @ g) for m, r in self.masses())


LENGTHS = np.array([VALUE[f"l{rod}"] for rod in RODS])
DELTA = Delta(Q, points("p", "123"), points("a", RODS), points("b", RODS), LENGTHS, elbow=np.zeros(3))


def drive(s):
    return replace(DELTA, q=Q + s)


def stretch(s):
    return replace(DELTA, length=DELTA.length + s)


def loads(deviates, count, energy=Delta.energy, step=1e-5):
    """Generalised forces −∂U/∂s (N, count) on coordinates s by central differences at s = 0."""
    out = np.empty((N, count))
    for j in range(count):
        s = np.zeros((N, count))
        s[:, j] = step
        out[:, j] = -(energy(deviates(s)) - energy(deviates(-s))) / (2 * step)
    return out


def assert_close(landing, estimate, rigid=None, percent=1.0, least=1e-7):
    """Deflections of the TCP within a percentage of their RMS."""
    reference = RIGID.tcp if rigid is None else rigid
    moved, expected = landing.tcp - reference, estimate - (DELTA.tcp() if rigid is None else rigid)
    size = np.sqrt(np.mean(np.sum(moved**2, axis=1)))
    assert size > least
    assert np.linalg.norm(moved - expected, axis=1).max() <= 0.01 * percent * size


def test_the_rigid_robots_agree():
    assert np.abs(DELTA.tcp() - RIGID.tcp).max() < 1e-11


# -- springs -----------------------------------------------------------------------------------------------------


@estimates("drive_compliance")
@pytest.mark.parametrize("compliance", [np.full(3, 16e-6), np.array([5e-6, 0.0, 40e-6])])
def test_drive_compliance(compliance):
    landing = land(faults.get("drive_compliance")(ROBOT, compliance=compliance, hardening=0.0))
    assert_close(landing, drive(compliance * loads(drive, 3)).tcp())


def test_drive_compliance_that_hardens():
    compliance, h = 2e-4, 0.8
    torque = loads(drive, 3)
    angle = compliance * torque
    for _ in range(50):  # k·φ·(1 + h·φ²/(1 mrad)²) = τ
        f = angle / compliance * (1 + h * angle**2 * 1e6) - torque
        angle = angle - f * compliance / (1 + 3 * h * angle**2 * 1e6)
    fault = faults.get("drive_compliance")(ROBOT, compliance=np.full(3, compliance), hardening=h)
    assert_close(land(fault), drive(angle).tcp(), percent=1.0)
    soft = compliance * torque
    assert np.abs(soft - angle).max() > 0.2 * np.abs(soft).max()


@estimates("rod_compliance")
@pytest.mark.parametrize("compliance", [np.full(6, 5e-8), np.array([1e-7, 0, 0, 2e-8, 0, 3e-7])])
def test_rod_compliance(compliance):
    landing = land(faults.get("rod_compliance")(ROBOT, compliance=compliance))
    assert_close(landing, stretch(compliance * loads(stretch, 6)).tcp())


@estimates("arm_bending")
@pytest.mark.parametrize(("vertical", "lateral"), [(2e-7, 0.0), (0.0, 2e-7), (3e-7, 1e-7)])
def test_arm_bending_is_an_euler_bernoulli_cantilever(vertical, lateral):
    """Ritz with w = c₂y² + c₃y³ + c₄y⁴, exact for forces and moments at the tip and uniform weight."""
    L = ROBOT.dimensions["arm_length"]
    powers = np.array([2, 3, 4])
    curve = powers * (powers - 1)
    elastic = curve[:, None] * curve / (np.add.outer(powers, powers) - 3) * L ** (np.add.outer(powers, powers) - 3.0)
    frame = E0 @ about([1, 0, 0], Q)  # (N, 3, 3, 3) arm frames
    beside = DELTA.a - [0, L, 0]
    ways = [np.array([0, 0, 1.0]), np.array([1.0, 0, 0])]
    axes = [np.array([1.0, 0, 0]), np.array([0, 0, -1.0])]  # a turn about these lifts the tip along its way

    def bend(s):
        s = s.reshape(N, 2, 3, 3)  # way, arm, coefficient
        elbow = np.zeros((N, 6, 3))
        for way in range(2):
            tip = s[:, way] @ L**powers
            turn = s[:, way] @ (powers * L ** (powers - 1.0))
            for r in range(6):
                local = tip[:, ARM[r], None] * ways[way] + turn[:, ARM[r], None] * np.cross(axes[way], beside[r])
                elbow[:, r] += (frame[:, ARM[r]] @ local[..., None])[..., 0]
        return replace(DELTA, elbow=elbow)

    force = np.concatenate([loads(bend, 18, step=1e-4)], axis=0).reshape(N, 2, 3, 3)
    weight = MASS["arm"] / L * L ** (powers + 1.0) / (powers + 1)  # ∫ (m/L)·yᵖ dy
    s = np.zeros((N, 2, 3, 3))
    for way, compliance in enumerate((vertical, lateral)):
        if compliance:
            along = (frame @ ways[way]) @ ROBOT.gravity  # (N, 3)
            total = force[:, way] + along[..., None] * weight
            s[:, way] = np.linalg.solve(L**3 / (3 * compliance) * elastic, total[..., None])[..., 0]
    fault = faults.get("arm_bending")(ROBOT, vertical=np.full(3, vertical), lateral=np.full(3, lateral))
    assert_close(land(fault), bend(s.reshape(N, 18)).tcp())


@estimates("tool_bending")
def test_tool_bending_is_a_cantilever_under_its_payload():
    R, c = DELTA.pose()[1], 2e-6
    h = np.linalg.norm(TOOL, axis=1, keepdims=True)
    along = (R @ (TOOL / h)[..., None])[..., 0]
    weight = PAYLOAD[:, None] * ROBOT.gravity
    across = weight - along * np.sum(along * weight, axis=1, keepdims=True)
    landing = land(typical("tool_bending"))
    assert_close(landing, DELTA.tcp() + c * (h / 0.1) ** 3 * across, percent=1.0)
    assert np.abs(landing.R - RIGID.R).max() < 1e-11  # the plate does not turn


@estimates("plate_flexing")
def test_plate_flexing():
    def flex(s):
        return replace(DELTA, b=DELTA.b + s[:, :, None] * [0, 0, 1.0])

    assert_close(land(typical("plate_flexing")), flex(1e-7 * loads(flex, 6)).tcp())


@estimates("frame_bending")
def test_frame_bending_tilts_the_robot_by_its_overhanging_weight():
    c, hinge = 2e-7, np.array([0, 0, 0.5])
    weights = ((r - hinge, np.broadcast_to(m, N)[:, None] * ROBOT.gravity) for m, r in DELTA.masses())
    moment = sum(np.cross(arm, weight) for arm, weight in weights)
    turn = turned(c * moment * [1, 1, 0])
    assert_close(land(typical("frame_bending")), hinge + (turn @ (DELTA.tcp() - hinge)[..., None])[..., 0], least=1e-7)


@estimates("hose")
def test_hose_pulls_through_whatever_gives_way():
    fault, soft = typical("hose"), typical("drive_compliance")
    anchor, low, k, rest = (fault.values[name] for name in ("anchor", "plate", "stiffness", "rest_length"))

    def pulled(robot):
        length = np.linalg.norm(robot.tcp(low) - anchor, axis=1)
        assert (length > rest).all()
        return robot.energy() + 0.5 * k * (length - rest) ** 2

    without = land(soft).tcp
    pull = 16e-6 * (loads(drive, 3, pulled) - loads(drive, 3))
    assert_close(land(soft, fault), without + drive(pull).tcp() - DELTA.tcp(), rigid=without)
    assert np.abs(land(fault).tcp - RIGID.tcp).max() < 1e-11  # a rigid robot does not feel it


@estimates("gravity_tilt")
def test_gravity_tilt_is_felt_through_a_compliance():
    soft, tilt = typical("drive_compliance"), typical("gravity_tilt")
    g = turned([5e-3, -3e-3, 0]) @ ROBOT.gravity
    without = land(soft).tcp
    more = 16e-6 * (loads(drive, 3, lambda robot: robot.energy(g)) - loads(drive, 3))
    assert_close(land(soft, tilt), without + drive(more).tcp() - DELTA.tcp(), rigid=without, least=1e-8)
    assert np.abs(land(tilt).tcp - RIGID.tcp).max() < 1e-11


# -- gaps and friction -------------------------------------------------------------------------------------------


@estimates("backlash")
def test_backlash_by_direction_and_by_load():
    half = 3e-4
    assert_close(land(typical("backlash")), drive(-half * DIRECTION).tcp())
    by_load = faults.get("backlash")(ROBOT, gap=np.full(3, 2 * half), side="load")
    side = np.sign(loads(drive, 3))
    assert (side < 0).all()  # nothing lifts the arms here; see below for a load that does
    assert_close(land(by_load), drive(half * side).tcp())
    quiet = Commands.of(Q, TOOL, PAYLOAD)  # no direction known: the load decides
    assert np.abs(land(typical("backlash"), commands=quiet).tcp - land(by_load).tcp).max() < 1e-12


def test_backlash_flips_where_the_load_does():
    """Held up by a counterweight of a payload: the arm's torque, and with it the flank, changes sign."""
    fault = faults.make(ROBOT, "backlash", {"gap_mrad": 1.0, "side": "load"})
    light = robots.parse(ROBOT.text.replace("arm_kg = 1.0", "arm_kg = 0.0"))
    up = robots.parse(light.text + "\n[gravity]\nvector_m_s2 = [0.0, 0.0, 9.81]\n")
    q = np.zeros((1, 3))
    down = Machine(light, None, [fault]).run(Commands.of(q, 0.0, 1.0)).x[0, 2]
    lifted = Machine(up, None, [fault]).run(Commands.of(q, 0.0, 1.0)).x[0, 2]
    rigid = Machine(light).land(q).x[0, 2]
    assert down < rigid < lifted and np.isclose(rigid - down, lifted - rigid, rtol=0.01)


@estimates("joint_clearance")
def test_joint_clearance_takes_the_side_of_the_rod_force():
    tension = loads(stretch, 6)
    assert (tension < 0).any() and (tension > 0).any()
    assert_close(land(typical("joint_clearance")), stretch(5e-6 * np.sign(tension)).tcp())


@estimates("friction_hysteresis")
def test_friction_hysteresis_winds_up_with_the_load():
    wind = -DIRECTION * 1e-5 * np.abs(loads(drive, 3))
    assert_close(land(typical("friction_hysteresis")), drive(wind).tcp())


def test_friction_hysteresis_equals_a_spring_slider_driven_through_its_loop():
    """MuJoCo's own plastic joint spring, yielding at μ·|τ| of the load on a drive and pushed past it either way."""
    machine = Machine(ROBOT, K, [typical("friction_hysteresis")])
    stiffness, friction = 2000.0, 0.02  # c = μ/k = 10 µrad/(N·m)
    for n in range(4):
        assert machine.run(COMMANDS.take(slice(n, n + 1))).ok.all()
        wound = [machine.rig.data.qpos[machine.model.joint(f"q{i}.windup").qposadr[0]] for i in (1, 2, 3)]
        for i in range(3):
            yields = friction * abs(machine.rig.load(f"q{i + 1}.windup"))
            model = mujoco.MjModel.from_xml_string(
                f"""<mujoco><compiler angle="radian"/><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
                <joint name="wind" type="hinge" stiffness="{stiffness}" damping="60"
                 springyield="{yields / stiffness:.17g}"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""
            )
            slider = mujoco.MjData(model)
            for push in (DIRECTION[n, i], -DIRECTION[n, i]):  # the stroke before, and the last one, which counts
                slider.qfrc_applied[0] = 1.5 * push * yields
                for _ in range(300):
                    mujoco.mj_step(model, slider)
            # The spring between motor and arm is stretched against the last motion by what friction holds back.
            assert np.isclose(slider.qpos[0] - slider.plastic[0], wound[i], rtol=1e-6)


# -- encoders and gears ------------------------------------------------------------------------------------------


@estimates("encoder_eccentricity", "encoder_ovality", "gear_ratio", "gear_ripple", "encoder_warming")
@pytest.mark.parametrize(
    ("name", "shift"),
    [
        ("encoder_eccentricity", -4e-4 * np.sin(Q + 0.7)),
        ("encoder_ovality", -2e-4 * np.sin(2 * (Q + 0.3))),
        ("gear_ratio", 2e-4 * Q),
        ("gear_ripple", 3e-4 * np.sin(24 * Q)),
        ("encoder_warming", 5e-6 * (WARM["temp_base"][:, None] - 20)),
    ],
)
def test_encoders_and_gears(name, shift):
    assert_close(land(typical(name)), drive(shift).tcp())


def test_an_eccentric_disc_seen_by_its_head():
    """The disc as a body in the plane: which of its lines stands under the head."""
    fault = faults.get("encoder_eccentricity")(ROBOT, amplitude=np.full(3, 0.05), phase=np.array([0.0, 1.0, -2.0]))
    shaft = np.array([0.4, -1.1, 0.9])
    for s, phase, read in zip(shaft, fault.values["phase"], fault.reading(shaft), strict=True):
        spin = np.array([[np.cos(s), -np.sin(s)], [np.sin(s), np.cos(s)]])
        centre = spin @ (0.05 * np.array([np.cos(phase), np.sin(phase)]))
        line = spin.T @ (np.array([1.0, 0.0]) - centre)  # from the disc's centre to the head, in the disc
        assert np.isclose(read, -np.arctan2(line[1], line[0]), atol=1e-15)


def test_a_tilted_disc_seen_by_its_head():
    """The disc as a plane in space: where the line of sight, along the shaft, meets it."""
    tilt, phase = 0.3, 0.8  # about a line of the disc at this angle
    amplitude = np.tan(tilt / 2) ** 2
    fault = faults.get("encoder_ovality")(ROBOT, amplitude=np.full(3, amplitude), phase=np.full(3, phase))
    shaft = np.array([0.4, -1.1, 0.9])
    for s, read in zip(shaft, fault.reading(shaft), strict=True):
        disc = turned([0, 0, s]) @ turned(tilt * np.array([np.cos(phase), np.sin(phase), 0]))  # disc → space
        normal = disc[:, 2]
        seen = disc.T @ [1.0, 0.0, -normal[0] / normal[2]]  # the point of the disc that lies under the head at (1, 0)
        assert abs(seen[2]) < 1e-15 and np.isclose(read, -np.arctan2(seen[1], seen[0]), atol=1e-14)
    assert np.abs(fault.reading(shaft) - shaft).max() > 0.5 * amplitude


# -- temperature, time, place ------------------------------------------------------------------------------------


@estimates("thermal_arms", "thermal_rods", "thermal_base")
@pytest.mark.parametrize(("part", "alpha"), [("arms", 23.6e-6), ("rods", 2e-6), ("base", 12e-6)])
def test_thermal_growth(part, alpha):
    landing = land(typical(f"thermal_{part}"))
    growth = 1 + alpha * (WARM[f"temp_{part}"] - 20)
    size = {"arms": "a", "rods": "length", "base": "p"}[part]
    grown = np.multiply.outer(growth, getattr(DELTA, size))
    assert np.abs(landing.tcp - replace(DELTA, **{size: grown}).tcp()).max() < 1e-10
    assert np.linalg.norm(landing.tcp - RIGID.tcp, axis=1).max() > 1e-6


@estimates("base_drift")
def test_base_drift_moves_everything():
    landing, fault = land(typical("base_drift")), typical("base_drift")
    turn = turned(TIME[:, None] * fault.values["w"])
    expected = (turn @ RIGID.tcp[..., None])[..., 0] + TIME[:, None] * fault.values["v"]
    assert np.abs(landing.tcp - expected).max() < 1e-11 and np.abs(landing.R - turn @ RIGID.R).max() < 1e-11
    assert np.abs(landing.tcp - RIGID.tcp).max() > 1e-5


@estimates("bearing_runout")
def test_bearing_runout_moves_the_motor_axis():
    angle = 2 * Q
    shift = 10e-6 * np.stack([np.zeros_like(Q), np.cos(angle), np.sin(angle)], axis=-1)  # arm frame at q = 0
    moved = (E0 @ shift[..., None])[..., 0]
    assert_close(land(typical("bearing_runout")), replace(DELTA, elbow=moved[:, ARM]).tcp())


@estimates("tool_creep")
def test_tool_creep():
    landing = land(typical("tool_creep"))
    lean = turned(np.log10(1 + TIME / 60.0)[:, None] * [2e-4, 1e-4, 0])
    expected = RIGID.x + (RIGID.R @ lean @ TOOL[..., None])[..., 0]
    assert np.abs(landing.tcp - expected).max() < 1e-12 and np.abs(landing.tcp - RIGID.tcp).max() > 1e-5


def measured(*present, **instrument):
    truth = truths.Truth(ROBOT, K - MECHANISM.nominal, Instrument(**instrument), present)
    plan = Plan(COMMANDS, np.full(N, -1), np.zeros(N, bool), "test")
    return simulate.run(truth, plan).measurements


@estimates("tracker_scale", "tracker_drift")
def test_tracker_scale_and_drift_in_the_trackers_own_frame():
    place, turn = np.array([2.0, -1.0, 0.3]), turned([0.2, 0.1, 1.0])
    frame = {"frame": "tracker", "position": place, "rotation": np.array([0.2, 0.1, 1.0])}
    scale, drift = typical("tracker_scale"), typical("tracker_drift")
    seen = (RIGID.tcp - place) @ turn
    assert np.abs(measured(scale, **frame).position - seen * (1 + 1e-5)).max() < 1e-12
    back = turned(-TIME[:, None] * drift.values["w"])
    crept = (back @ (seen - TIME[:, None] * drift.values["v"])[..., None])[..., 0]
    assert np.abs(measured(drift, **frame).position - crept).max() < 1e-12
    both = measured(scale, drift, **frame).position
    assert np.abs(both - crept * (1 + 1e-5)).max() < 1e-12
    assert np.array_equal(both, measured(drift, scale, **frame).position)


# -- all of them -------------------------------------------------------------------------------------------------


# -- faults with a date, and steps of an encoder -------------------------------------------------------------------

COMMANDED = np.random.default_rng(11).uniform(-0.85, 0.3, (20, 3))


@estimates("motor_slip")
def test_a_motor_slips_once():
    slip = faults.make(ROBOT, "motor_slip", {"slip_urad": [0, 300, 0], "row": 13})
    moved = COMMANDED + 3e-4 * np.array([0, 1, 0]) * (np.arange(20) >= 12)[:, None]
    landed = Machine(ROBOT, None, [slip]).land(COMMANDED).tcp
    assert np.allclose(landed, Machine(ROBOT).land(moved).tcp, atol=1e-12)


@estimates("tracker_bump")
def test_a_bumped_tracker_sees_everything_elsewhere_from_then_on():
    bump = faults.make(ROBOT, "tracker_bump", {"shift_um": [50, 0, 0], "turn_urad": [0, 0, 100], "row": 13})
    truth = truths.Truth(ROBOT, np.zeros(60), Instrument(), (bump,))
    plan = Plan(Commands.of(COMMANDED), np.full(20, -1), np.zeros(20, bool), "test")
    seen = simulate.run(truth, plan).measurements.position
    there = Machine(ROBOT).land(COMMANDED).tcp
    after = (there - [5e-5, 0, 0]) @ turned(np.array([0, 0, 1e-4]))
    assert np.allclose(seen[:12], there[:12], atol=1e-15) and np.allclose(seen[12:], after[12:], atol=1e-12)


def test_dated_faults_know_their_row_whoever_does_the_work():
    slip = faults.make(ROBOT, "motor_slip", {"slip_urad": 300, "row": 100})
    truth = truths.Truth(ROBOT, np.zeros(60), Instrument(), (slip,))
    plan = plans.make(ROBOT, "random", 140, seed=1)
    one, two = (simulate.run(truth, plan, workers=w).measurements.position for w in (1, 2))
    there = Machine(ROBOT).land(plan.commands.q).tcp
    assert np.array_equal(one, two) and np.flatnonzero(np.abs(one - there).max(axis=1) > 1e-9)[0] == 99


@estimates("encoder_steps")
def test_an_encoder_of_few_bits_stops_at_its_steps():
    steps = faults.make(ROBOT, "encoder_steps", {"step_urad": 192})
    landed = Machine(ROBOT, None, [steps]).land(COMMANDED).tcp
    assert np.allclose(landed, Machine(ROBOT).land(np.round(COMMANDED / 192e-6) * 192e-6).tcp, atol=1e-12)


# -- laws that no one has listed ---------------------------------------------------------------------------------


def lawful(channel, amplitude, *terms, scale=1.0):
    """The fault with a law that is written here."""
    out = faults.make(ROBOT, "random_law", {"scale": scale})
    out.laws = (Law(channel, "each", np.array(amplitude), tuple(Term(*term) for term in terms)),)
    return out


def moved_rods(change):
    """TCPs (N, 3) of the robot whose rods differ by `change` (N, 6) [m], row by row."""
    out = []
    for n, by in enumerate(change):
        k = K + sum(by[r] * (np.array(MECHANISM.parameters) == f"l{RODS[r]}") for r in range(6))
        out.append(Machine(ROBOT, k).run(COMMANDS.take(slice(n, n + 1))).tcp[0])
    return np.array(out)


@estimates("random_law")
def test_a_law_moves_what_it_says():
    payload, warm = PAYLOAD / 2.0, (WARM["temp_arms"] - 20.0) / 6.0
    shift = np.array([3e-5, -2e-5, 4e-5])
    law = lawful("tool_point", shift, ("payload", "square", 1, 0), ("temp_arms", "kink", 1, 0.4))
    size = payload**2 * np.maximum(warm - 0.2, 0)
    assert np.allclose(land(law).tcp, RIGID.tcp + (RIGID.R @ shift) * size[:, None], atol=1e-12)

    law = lawful("motor", [1e-4, 0, -2e-4], ("q", "wave", 2.0, 0.5))
    low, high = ROBOT.joint_range
    u = (Q - 0.5 * (low + high)) / (0.5 * (high - low))
    there = Q + np.array([1e-4, 0, -2e-4]) * np.sin(12 * u + np.pi / 2)
    assert np.allclose(land(law).tcp, land(commands=replace(COMMANDS, q=there)).tcp, atol=1e-10)

    law = lawful("base_shift", shift, ("payload", "linear", 1, 0))
    assert np.allclose(land(law).tcp, RIGID.tcp + payload[:, None] * shift, atol=1e-12)


def test_a_law_of_rods_sees_their_forces():
    law = lawful("rod", np.arange(1, 7) * 1e-5, ("load", "saturated", 2.0, 0.0))
    machine = Machine(ROBOT, K, [law])
    change = []
    for n in range(N):
        machine.run(COMMANDS.take(slice(n, n + 1)))
        forces = np.array([machine.rig.load(f"rod{rod}.law") for rod in RODS])
        change.append(np.arange(1, 7) * 1e-5 * np.tanh(2.0 * forces / 20.0))
    assert np.abs(change).max() > 1e-5
    assert np.allclose(land(law).tcp, moved_rods(np.array(change)), atol=1e-10)


def test_a_memory_is_that_of_the_rows_before_whoever_does_the_work():
    law = lawful("motor", np.full(3, 1e-4), ("play", "linear", 1, 0))
    width = 0.15 * np.ptp(ROBOT.joint_range)
    play = np.array([law.history(COMMANDS)[f"random_law.play{i}"] for i in (1, 2, 3)]).T
    far = np.abs(np.diff(Q, axis=0)) > 2 * width  # a motion longer than the play ends at its far side
    assert far.any() and np.allclose(play[1:][far], np.sign(np.diff(Q, axis=0))[far])
    assert np.abs(play).max() <= 1 + 1e-12 and not play[0].any()
    truth = truths.Truth(ROBOT, K - MECHANISM.nominal, Instrument(), (law,))
    many = Commands.of(np.tile(Q, (9, 1)))
    plan = Plan(many, np.full(len(many), -1), np.zeros(len(many), bool), "test")
    whole = Machine(ROBOT, K, [law]).run(many).tcp
    assert np.array_equal(simulate.run(truth, plan).measurements.position, whole)


def test_seeds_draw_every_channel_and_every_shape():
    laws = [law for seed in range(200) for law in random_laws.draw({"actuator": 3, "rod": 6, "axis": 3}, seed)]
    assert {law.channel for law in laws} == set(random_laws.CHANNELS) and len(laws) > 220
    assert {term.shape for law in laws for term in law.terms} == set(random_laws.SHAPES)


def test_every_fault_is_estimated_here(own_tests):
    assert ESTIMATED <= set(faults.names()) <= ESTIMATED | own_tests


@pytest.mark.parametrize("name", faults.names())
def test_at_zero_the_rigid_robot(name):
    zero = typical(name, 0.0)
    assert zero.absent and np.array_equal(measured(zero).position, measured().position)
    # Built into the model with all of its joints and springs, but of no size worth the name: still the rigid robot.
    none = typical(name, 1e-10)
    assert not none.absent and np.abs(measured(none).position - measured().position).max() <= 1e-12
    # And on the way there in proportion: a thousandth of the size moves the TCP a thousandth as far.
    if name == "encoder_steps":  # rounding is bounded by half a step, and in no proportion to it
        return
    partner = () if name not in ("hose", "gravity_tilt") else (typical("drive_compliance"),)
    rest = measured(*partner).position
    full, small = (measured(typical(name, s), *partner).position - rest for s in (1.0, 1e-3))
    size = np.abs(full).max()
    assert size > 1e-8 and np.abs(small - 1e-3 * full).max() < 1e-3 * size * 0.02 + 2e-12


def test_any_order_gives_the_same_robot():
    everything = [typical(name) for name in faults.names()]
    one, other = land(*everything), land(*everything[::-1])
    assert np.array_equal(one.tcp, other.tcp) and np.array_equal(one.R, other.R)


def test_small_faults_add_up():
    """Of small deflections the combination is the sum, to second order."""
    names = ["drive_compliance", "rod_compliance", "backlash", "thermal_arms", "gear_ripple", "base_drift"]
    both = land(*(typical(name) for name in names)).tcp - RIGID.tcp
    total = sum(land(typical(name)).tcp - RIGID.tcp for name in names)
    assert np.abs(both - total).max() < 0.01 * np.abs(total).max()
