"""Effects of the user's own: the template works, and every slip is named with file and line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import compensation, effects, prediction
from pcalib import robot as robots
from pcalib.effects import user
from pcalib.errors import EffectError
from pcalib.model import FittedEffect, Model
from pcalib.prediction import Conditions

ROBOT = robots.load(Path(__file__).parents[2] / "models" / "delta.toml")
HEAD = "import numpy as np\nfrom pcalib.effects import Contribution, EffectParameter\n"


def write(folder, body="return Contribution(actuator=theta[0] * at.q)", **change):
    said = {"name": '"my_effect"', "parameters": '(EffectParameter("size", "urad", 1e-4),)', "needs": "()"} | change
    lines = "\n".join(f"    {key} = {value}" for key, value in said.items() if value)
    code = "\n".join(f"        {line}" for line in body.splitlines())
    file = folder / "mine.py"
    file.write_text(f"{HEAD}class Mine:\n{lines}\n    def contribution(self, at, theta):\n{code}\n")
    return f"{file}:Mine"


def line_of(spec, text):
    path = Path(spec.rpartition(":")[0])
    return next(i for i, line in enumerate(path.read_text().splitlines(), 1) if text in line)


def test_template_loads_and_is_ten_lines_or_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    filename, classname, text = user.template("WormGear")
    assert (filename, classname) == ("worm_gear.py", "WormGear")
    Path(filename).write_text(text)
    effect = effects.parse(f"{filename}:{classname}", ROBOT)
    assert effect.name == "worm_gear" and effect.linear and effect.channels == ("actuator",)
    assert len([line for line in text.splitlines() if line.strip()]) <= 12
    assert effect.describe(np.array([3e-4])) == "amplitude 300 µrad"
    assert effect.spec == "worm_gear.py:WormGear"
    assert not list(tmp_path.glob("__pycache__"))


@pytest.mark.parametrize("bad", ["", "1abc", "a-b", "../x"])
def test_template_refuses_names(bad):
    with pytest.raises(EffectError, match="cannot name an effect"):
        user.template(bad)


def test_basis_of_a_linear_and_a_nonlinear_one(tmp_path):
    at = user.trial(ROBOT)
    straight = effects.parse(write(tmp_path), ROBOT)
    assert straight.linear
    np.testing.assert_allclose(straight.basis(at)[0].actuator, at.q)
    bent = effects.parse(write(tmp_path, "return Contribution(actuator=np.sin(500 * theta[0]) * at.q)"), ROBOT)
    assert not bent.linear
    slope = bent.basis(at, np.array([1e-3]))[0].actuator
    np.testing.assert_allclose(slope, 500 * np.cos(0.5) * at.q, rtol=1e-6)


def test_columns_of_the_data_reach_it(tmp_path):
    spec = write(
        tmp_path,
        'return Contribution(rod=theta[0] * at.column("humidity")[:, None] * np.ones((1, 6)))',
        needs='("humidity",)',
    )
    effect = effects.parse(spec, ROBOT)
    assert effects.missing(effect, {}) == ["humidity"] and effect.channels == ("rod",)


@pytest.mark.parametrize("base", ["", "(Effect)"])
def test_a_class_with_or_without_the_base_has_every_member(tmp_path, base):
    spec = write(tmp_path, wants='("humidity",)')
    file = tmp_path / "mine.py"
    extra = "    def unsuited(self, mechanism):\n        return 'no arms' if mechanism.kind == 'hexapod' else ''\n"
    file.write_text("from pcalib.effects import Effect\n" + file.read_text().replace("Mine:", f"Mine{base}:") + extra)
    effect = effects.parse(spec, ROBOT)
    assert isinstance(effect, effects.Effect) and effect.spec == spec and effect.title == "my effect"
    assert effect.wants == ("humidity",) and effect.unsuited(ROBOT.mechanism) == "" and not effect.indirect
    assert effect.describe(np.array([2e-5])) == "size 20 µrad" and effect.linear


def test_a_basis_of_the_users_own_is_used_and_checked(tmp_path):
    spec = write(tmp_path)
    file = tmp_path / "mine.py"
    own = "    def basis(self, at, theta=None):\n        return [Contribution(actuator={})]\n"
    text = file.read_text()
    file.write_text(text + own.format("1.0 * at.q"))
    assert effects.parse(spec, ROBOT).basis(at := user.trial(ROBOT))[0].actuator.tolist() == at.q.tolist()
    for slip, message in (("2 * at.q", "basis is not the derivative"), ("1 / 0", "Mine.basis raised ZeroDivision")):
        file.write_text(text + own.format(slip))
        with pytest.raises(EffectError, match=rf"mine.py:\d+: .*{message}"):
            effects.parse(spec, ROBOT)


SLIPS = {
    "raises": ("x = 1\nreturn 1 / 0", {}, r"mine.py:{line}: Mine.contribution raised ZeroDivisionError", "1 / 0"),
    "type": ("return theta[0] * at.q", {}, r"mine.py:{line}: Mine: contribution returned ndarray", "def contribution"),
    "shape": (
        "return Contribution(actuator=theta[0] * at.q[:, :2])",
        {},
        r"actuator has shape \(9, 2\), not \(9, 3\)",
        None,
    ),
    "text": ('return Contribution(actuator="x")', {}, "not an array of numbers", None),
    "nan": (
        "return Contribution(actuator=theta[0] * np.log(-at.q**2))",
        {},
        r"mine.py:{line}: Mine: actuator is not finite at pose 0",
        "def contribution",
    ),
    "zero": ("return Contribution(actuator=theta[0] + 0 * at.q + 1e-6)", {}, "theta = 0 adds something", None),
    "flat": ("return Contribution(actuator=theta[0]**2 * at.q)", {}, "'size' changes nothing at zero", None),
    "steep": ("return Contribution(actuator=np.sign(theta[0]) * np.inf_ * at.q)", {}, "AttributeError", None),
    "rows": (
        "return Contribution(actuator=theta[0] * (at.q - at.q.mean(axis=0)))",
        {},
        "depends on which other poses",
        None,
    ),
    "empty": ("return Contribution()", {}, "contribution is empty", None),
    "column": (
        'return Contribution(actuator=theta[0] * at.columns["humid"][:, None] * at.q)',
        {},
        "KeyError: humid",
        None,
    ),
    "unit": (
        "return None",
        {"parameters": '(EffectParameter("size", "furlong", 1.0),)'},
        "unknown unit 'furlong'",
        None,
    ),
    "prior": ("return None", {"parameters": '(EffectParameter("size", "urad", 0.0),)'}, "not positive", None),
    "range": (
        "return None",
        {"parameters": '(EffectParameter("size", "urad", 1e-4, 1e-5),)'},
        "outside its range",
        None,
    ),
    "twice": (
        "return None",
        {"parameters": '(EffectParameter("a", "urad", 1.), EffectParameter("a", "urad", 1.))'},
        "twice",
        None,
    ),
    "tuple": ("return None", {"parameters": '(("a", "urad", 1.0),)'}, "is no EffectParameter", None),
    "none": ("return None", {"parameters": ""}, "parameters is missing", None),
    "name": ("return None", {"name": '"My Effect"'}, "name is 'My Effect'", None),
    "library": ("return None", {"name": '"backlash"'}, "effect of the library", None),
    "needs": ("return None", {"needs": '"humidity"'}, "needs is 'humidity'", None),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_slips_are_named(tmp_path, slip):
    body, change, message, at_line = SLIPS[slip]
    spec = write(tmp_path, body, **change)
    if at_line:
        message = message.replace("{line}", str(line_of(spec, at_line)))
    with pytest.raises(EffectError, match=message) as caught:
        effects.parse(spec, ROBOT)
    assert "mine.py" in str(caught.value)


def test_nan_that_shows_only_in_use_is_caught(tmp_path):
    effect = effects.parse(
        write(tmp_path, "return Contribution(actuator=theta[0] * np.sqrt(0.01 - theta[0]) * at.q)"), ROBOT
    )
    with pytest.raises(EffectError, match=r"mine.py:\d+: Mine: actuator is not finite"):
        effect.contribution(user.trial(ROBOT), np.array([1.0]))


def test_files(tmp_path):
    with pytest.raises(EffectError, match="no such file"):
        effects.parse(str(tmp_path / "none.py:X"))
    with pytest.raises(EffectError, match=r"write file\.py:ClassName"):
        effects.parse("thing.py")
    file = tmp_path / "broken.py"
    file.write_text("x = 1\nclass A(:\n")
    with pytest.raises(EffectError, match=r"broken.py:2: invalid syntax"):
        effects.parse(f"{file}:A")
    file.write_text("x = 1\nimport no_such_thing\n")
    with pytest.raises(EffectError, match=r"broken.py:2: loading raised ModuleNotFoundError"):
        effects.parse(f"{file}:A")
    file.write_text(HEAD + "class Right:\n    def contribution(self, at, theta): pass\n")
    with pytest.raises(EffectError, match="did you mean 'Right'"):
        effects.parse(f"{file}:Rigth")
    file.write_text(
        HEAD + "class A:\n    def __init__(self):\n        raise ValueError('no')\n    def contribution(self): pass"
    )
    with pytest.raises(EffectError, match=r"broken.py:5: A raised ValueError: no"):
        effects.parse(f"{file}:A")


@pytest.mark.parametrize("method", compensation.METHODS)
def test_is_not_asked_about_poses_that_do_not_exist(tmp_path, method):
    """Where there is no pose there are no loads; the other rows are as if these were not there."""
    soft = effects.parse(write(tmp_path, "return Contribution(actuator=theta[0] * at.torque)"), ROBOT)
    model = replace(Model.nominal(ROBOT), effects=(FittedEffect(soft, np.array([5e-5])),))
    good = np.array([[0, 0, -0.8], [0.1, -0.05, -0.75]])
    far = np.array([[1.35, 0, 0], [np.nan, 0, -0.8], [0, 0, -5.0]])
    alone = compensation.compensate(model, good, method=method)
    beside = compensation.compensate(model, np.vstack([far, good]), method=method, limits=False)
    assert beside.status.tolist() == ["unreachable"] * 3 + ["ok"] * 2
    np.testing.assert_allclose(beside.q[3:], alone.q, atol=1e-13)
    assert set(compensation.compensate(model, far, method=method, limits=False).status) == {"unreachable"}
    q = np.vstack([[[np.nan, 0, 0], [2.5, -2.5, 0.5]], alone.q])
    there = prediction.predict(model, q, Conditions.of(4))
    assert there.status[0] == "not_converged" and (there.status[2:] == "ok").all()
    np.testing.assert_allclose(
        there.position[2:], prediction.predict(model, alone.q, Conditions.of(2)).position, atol=1e-13
    )
