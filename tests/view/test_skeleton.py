"""What is drawn of a robot: rods of their true length, arms that turn about their motors, for every kind."""

from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib.errors import ReachError
from pcalib.model import Model
from pcalib.view.skeleton import rest, skeleton

MODELS = Path(__file__).parents[2] / "models"
KINDS = sorted(f.stem for f in MODELS.glob("*.toml") if "." not in f.stem)
PARTS = {  # rods, arms, rails, legs, plate bodies
    "delta": (6, 3, 0, 0, 1), "h4": (8, 4, 0, 0, 2), "hexa": (6, 6, 0, 0, 1), "hexa321": (6, 6, 0, 0, 1),
    "hexapod": (0, 0, 0, 6, 1), "linear_delta": (6, 0, 3, 0, 1), "planar": (2, 0, 0, 0, 1),
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_has_its_parts(name, own_tests):
    robot = robots.load(MODELS / f"{name}.toml")
    s = skeleton(Model.nominal(robot), rest(robot))
    drawn = (len(s.rods), len(s.arms), len(s.rails), len(s.legs), len(s.plates))
    assert drawn == PARTS[robot.kind] if robot.kind in PARTS else robot.kind in own_tests and any(drawn)
    assert np.isfinite(s.points).all() and robot.workspace.contains(s.pose.x).all()


def test_the_delta_is_drawn_to_measure(delta, perturb):
    model = Model(delta, perturb(3, 1.0, 0.3))
    q = rest(delta)
    s = skeleton(model, q)
    k = dict(zip(delta.mechanism.parameters, model.k, strict=True))
    lengths = np.linalg.norm(s.rods[:, 1] - s.rods[:, 0], axis=1)
    assert lengths == pytest.approx([k[f"l{r}"] for r in delta.mechanism.rods], abs=1e-9)
    # An arm starts on its motor axis, at P_i plus what the two anchors lie along it, and is about as long as a_ij.y.
    for i in range(3):
        p = np.array([k[f"p{i + 1}.{c}"] for c in "xyz"])
        along = s.motors[i, 1] - s.motors[i, 0]
        along /= np.linalg.norm(along)
        off = s.arms[i, 0] - p
        assert np.linalg.norm(off - (off @ along) * along) < 1e-7
        middle = [np.mean([k[f"a{i + 1}{j}.{c}"] for j in (1, 2)]) for c in "yz"]
        assert np.linalg.norm(s.arms[i, 1] - s.arms[i, 0]) == pytest.approx(np.linalg.norm(middle), abs=1e-7)


def test_rails_span_the_joint_range():
    robot = robots.load(MODELS / "linear_delta.toml")
    s = skeleton(Model.nominal(robot), rest(robot))
    assert np.linalg.norm(s.rails[:, 1] - s.rails[:, 0], axis=1) == pytest.approx(robot.joint_max - robot.joint_min)


def test_a_robot_that_cannot_be_assembled_is_refused(delta):
    short = delta.mechanism.nominal.copy()
    short[[delta.mechanism.index(f"l{rod}") for rod in delta.mechanism.rods]] = 0.1
    with pytest.raises(ReachError, match="cannot stand"):
        skeleton(Model(delta, short), rest(delta))
