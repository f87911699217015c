"""Plans keep to the workspace and the joint range of the nominal robot, and vary what they say they vary."""

import numpy as np
import pytest

from bench import plan as plans
from bench.kinds import MODELS
from bench.machine import Machine
from bench.reach import reach
from pcalib import robot as robots
from pcalib import rotation
from pcalib.errors import InputError, ReachError
from pcalib.mechanics import kinematics

ROBOT = robots.load(MODELS / "delta.toml")
SPACE = ROBOT.workspace


def plate_of(plan):
    """By the core, which the plans know nothing of."""
    mechanism = ROBOT.mechanism
    solution = kinematics.forward(mechanism, mechanism.nominal, plan.commands.q)
    assert solution.ok.all()
    return solution.pose.x


def test_reach_agrees_with_the_core():
    x = np.array([[0.1, -0.2, -0.8], [0.0, 0.0, -0.7], [-0.15, 0.1, -0.85]])
    q, ok = reach(Machine(ROBOT), x)
    mechanism = ROBOT.mechanism
    assert ok.all() and np.abs(kinematics.forward(mechanism, mechanism.nominal, q).pose.x - x).max() < 1e-11
    assert not reach(Machine(ROBOT), np.array([[0.0, 0.0, -1.5]]))[1].any()


def test_random_is_uniform_in_the_reachable_workspace():
    plan = plans.make(ROBOT, "random", 600, seed=4)
    x = plate_of(plan)
    assert SPACE.contains(x).all()
    low, high = ROBOT.joint_range
    assert (plan.commands.q >= low).all() and (plan.commands.q <= high).all()
    # Well inside, where everything can be reached, equal volumes hold equal numbers.
    core = x[(np.hypot(x[:, 0], x[:, 1]) < 0.2) & (x[:, 2] > -0.85) & (x[:, 2] < -0.7)]
    inner = (np.hypot(core[:, 0], core[:, 1]) < 0.2 / np.sqrt(2)).mean()
    upper = (core[:, 2] > -0.775).mean()
    assert len(core) > 60 and abs(inner - 0.5) < 4 * 0.5 / np.sqrt(len(core)) > abs(upper - 0.5)


def test_border_lies_on_the_edge_of_what_can_be_reached():
    plan = plans.make(ROBOT, "border", 60, seed=1)
    x, q = plate_of(plan), plan.commands.q
    assert SPACE.contains(x, 1e-6).all()
    middle = np.array([0, 0, 0.5 * (SPACE.z_min + SPACE.z_max)])
    beyond = middle + 1.02 * (x - middle)
    out = ~SPACE.contains(beyond) | ~reach(Machine(ROBOT), beyond)[1]
    assert out.all() and (q >= ROBOT.joint_min).all() and (q <= ROBOT.joint_max).all()


def test_rich_varies_everything_apart_from_everything():
    plan = plans.make(ROBOT, "rich", 120, check=24, seed=2)
    c, columns = plan.commands, plan.commands.columns
    assert abs(len(plan) - 144) <= 1 and abs(plan.check.sum() - 24) <= 1
    assert set(np.unique(c.payload)) == {0.0, 1.0, 2.0}
    for i in (1, 2, 3):
        assert set(np.unique(columns[f"dir{i}"])) == {-1.0, 1.0}
    varied = [columns[key] for key in ("temp_arms", "temp_rods", "temp_base", "time", "dir1", "dir2", "dir3")]
    related = np.corrcoef([*varied, c.payload, *c.q.T])
    assert np.abs(related - np.eye(len(related)))[:7].max() < 0.45
    ids, counts = np.unique(plan.pose_id[plan.pose_id >= 0], return_counts=True)
    assert (counts == 2).all() and len(ids) >= 15
    for one in ids:
        rows = np.flatnonzero(plan.pose_id == one)
        assert (c.q[rows] == c.q[rows[0]]).all() and np.ptp(c.payload[rows]) == 0 and len(set(plan.check[rows])) == 1
        assert all(np.ptp(v[rows]) == 0 for key, v in columns.items() if key != "time")


def test_plain_varies_nothing():
    plan = plans.make(ROBOT, "plain", 30)
    assert not plan.commands.columns and not plan.commands.payload.any() and (plan.pose_id == -1).all()


def test_tools_and_payloads_are_dealt_out_evenly():
    tools = [np.zeros(3), np.array([0, 0, -0.1]), np.array([0, 0, -0.3])]
    plan = plans.make(ROBOT, "random", 30, tools=tools, payloads=[0.5, 1.5])
    assert [(plan.commands.tool == tool).all(axis=1).sum() for tool in tools] == [10, 10, 10]
    assert (plan.commands.payload == 0.5).sum() == 15


@pytest.mark.parametrize("name", plans.NAMES)
def test_what_a_plan_brings_is_known_by_its_name(name):
    assert set(plans.make(ROBOT, name, 6).commands.columns) == set(plans.columns(name, 3))


def test_the_seed_fixes_the_plan():
    first, again, other = (plans.make(ROBOT, "rich", 24, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.commands.q, again.commands.q)
    assert not np.array_equal(first.commands.q, other.commands.q)


def test_a_file_brings_its_commands_and_conditions(tmp_path):
    file = tmp_path / "plan.csv"
    file.write_text(
        "q1_deg,q2_deg,q3_deg,payload_g,temp_degC,tool_x_mm,tool_y_mm,tool_z_mm,dir1,pose_id,set,my_column\n"
        "10,-20,5,500,21.5,0,0,-100,1,a,fit,3\n10,-20,5,500,21.5,0,0,-100,-1,a,check,4\n"
    )
    plan = plans.make(ROBOT, file)
    c = plan.commands
    assert np.allclose(c.q[0], np.radians([10, -20, 5])) and np.allclose(c.payload, 0.5)
    assert np.allclose(c.columns["temp_rods"], 21.5) and np.allclose(c.tool[:, 2], -0.1)
    assert plan.pose_id.tolist() == [0, 0] and plan.check.tolist() == [False, True]
    assert c.columns["my_column"].tolist() == [3, 4]


def test_payloads_are_those_of_the_file_or_asked_for(tmp_path):
    file = tmp_path / "plan.csv"
    file.write_text("q1_deg,q2_deg,q3_deg,payload_kg\n10,-20,5,0.5\n")
    with pytest.raises(InputError, match=r"plan\.csv.*payloads of its own.*\n.*leave out --payload"):
        plans.make(ROBOT, file, payloads=[2.0])
    file.write_text("q1_deg,q2_deg,q3_deg\n10,-20,5\n")
    assert plans.make(ROBOT, file, payloads=[2.0]).commands.payload.tolist() == [2.0]


def test_the_noise_of_a_data_file_is_no_column_of_a_plan(tmp_path):
    """What measures next states its own."""
    file = tmp_path / "data.csv"
    head = "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg"
    file.write_text(f"{head},sigma_pos_mm,sigma_rot_mrad,mine\n10,-20,5,0,0,-700,0,0,0,0.5,3,7\n")
    assert list(plans.make(ROBOT, file).commands.columns) == ["mine"]


def test_rows_to_check_follow_those_of_a_file(tmp_path):
    file = tmp_path / "plan.csv"
    file.write_text(
        "q1_deg,q2_deg,q3_deg,payload_g,temp_degC,tool_x_mm,tool_y_mm,tool_z_mm,dir1,time_s,pose_id,set\n"
        "10,-20,5,500,21,0,0,-100,1,0,a,fit\n-5,-20,5,0,25,0,0,-300,-1,50,b,check\n"
    )
    plan, bare = plans.make(ROBOT, file, check=30, seed=3), plans.make(ROBOT, file)
    c, own = plan.commands, bare.commands
    assert plan.check.tolist() == [False, True, *[True] * 30] and (plan.pose_id[2:] == -1).all()
    assert np.array_equal(c.q[:2], own.q) and SPACE.contains(plate_of(plan)[2:]).all()
    assert len(np.unique(c.q[2:], axis=0)) == 30
    for row in range(2, 32):  # all conditions of one row, or all of the other
        like = 0 if c.payload[row] else 1
        assert (c.tool[row] == own.tool[like]).all()
        assert all(c.columns[name][row] == own.columns[name][like] for name in ("temp_arms", "dir1"))
    assert (c.payload[2:] > 0).sum() == 15 and c.columns["time"][2:].tolist() == [50 + 20 * i for i in range(1, 31)]
    assert np.array_equal(c.q, plans.make(ROBOT, file, check=30, seed=3).commands.q)
    assert not np.array_equal(c.q[2:], plans.make(ROBOT, file, check=30, seed=4).commands.q[2:])
    with pytest.raises(InputError, match="-1 rows to check make no sense"):
        plans.make(ROBOT, file, check=-1)


def test_a_row_that_is_neither_to_fit_nor_to_check(tmp_path):
    file = tmp_path / "plan.csv"
    file.write_text("q1_deg,q2_deg,q3_deg,set\n1,2,3,fit\n1,2,3,chek\n")
    with pytest.raises(InputError, match=r"plan\.csv:3: .*'chek' is no set"):
        plans.make(ROBOT, file)


def test_bad_plans():
    with pytest.raises(InputError, match="did you mean 'random'"):
        plans.make(ROBOT, "randon")
    with pytest.raises(InputError, match="no such file"):
        plans.make(ROBOT, "nowhere.csv")
    with pytest.raises(InputError, match="makes no sense"):
        plans.make(ROBOT, "random", 0)
    far = ROBOT.text.replace("z_min_mm = -925", "z_min_mm = -1925").replace("z_max_mm = -675", "z_max_mm = -1675")
    with pytest.raises(ReachError, match="all but out of its reach"):
        plans.make(robots.parse(far), "random", 2)


@pytest.mark.parametrize("name", ["hexa", "h4"])
def test_orientation_is_varied_where_it_is_commanded(name):
    robot = robots.load(MODELS / f"{name}.toml")
    plan = plans.make(robot, "random", 30)
    R = Machine(robot).land(plan.commands.q).R
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    assert np.abs(yaw).max() > 0.5 * robot.workspace.yaw
    if 3 in robot.mechanism.task:
        tilt = np.linalg.norm(rotation.log(R), axis=1)
        assert tilt.max() > 0.4 * robot.workspace.tilt
