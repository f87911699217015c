"""Model files: what is written is read back, what is broken is refused, and no code is loaded unasked."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcalib import effects, modelfile, rotation, summary
from pcalib.errors import EffectError, InputError, PcalibError
from pcalib.fitting import identification
from pcalib.model import FitOptions, FittedEffect, Frame, Model

FRAME = Frame(rotation.exp(np.array([0.3, -0.5, 2.6])), np.array([2.5, -1.0, 0.8]), np.array([3e-3, -4e-3, 2e-3]))


def fitted(delta, spec, seed=0):
    effect = effects.parse(spec, delta)
    rng = np.random.default_rng(seed)
    prior = np.array([p.prior for p in effect.parameters])
    return FittedEffect(effect, prior * rng.standard_normal(len(prior)), spec, prior * rng.random(len(prior)))


@pytest.fixture
def model(delta, perturb):
    k = perturb(40)
    sigma = np.abs(k - delta.mechanism.nominal)
    sigma[::7] = np.nan
    every = tuple(
        fitted(delta, spec, i) for i, spec in enumerate(["drive_compliance:arm", "gear_ripple@24+48", "base_drift"])
    )
    return Model(delta, k, "complete", every, FRAME, sigma)


def same(a: Model, b: Model) -> None:
    assert a.robot.name == b.robot.name and a.level == b.level
    assert np.abs(a.k - b.k).max() <= 1e-15
    np.testing.assert_allclose(a.robot.mechanism.nominal, b.robot.mechanism.nominal, atol=1e-15)
    assert (a.sigma is None) == (b.sigma is None)
    if a.sigma is not None and b.sigma is not None:
        np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-14)
    assert len(a.effects) == len(b.effects)
    for one, two in zip(a.effects, b.effects, strict=True):
        assert one.effect == two.effect
        np.testing.assert_allclose(one.theta, two.theta, rtol=1e-14)
        assert (one.sigma is None) == (two.sigma is None)
        if one.sigma is not None and two.sigma is not None:
            np.testing.assert_allclose(one.sigma, two.sigma, rtol=1e-14)
    assert (a.frame is None) == (b.frame is None)
    if a.frame is not None and b.frame is not None:
        assert np.abs(a.frame.rotation - b.frame.rotation).max() < 1e-15
        assert np.abs(a.frame.translation - b.frame.translation).max() < 1e-15
        assert np.abs(a.frame.offset - b.frame.offset).max() < 1e-15


def test_what_is_saved_is_loaded(model, tmp_path):
    path = tmp_path / "m.toml"
    modelfile.save(path, model, {"rms_pos_um": 21.5, "note": None})
    back = modelfile.load(path)
    same(model, back)
    again = modelfile.dumps(back)
    same(back, modelfile.loads(again))
    table = tomllib.loads(path.read_text("utf-8"))
    assert table["schema"] == "pcalib.model/1" and table["statistics"] == {"rms_pos_um": 21.5}
    assert table["parameters"]["l11"]["nominal_mm"] == 800.0 and "value_deg" in table["parameters"]["beta1.x"]


def test_how_it_was_fitted_is_kept(model):
    how = FitOptions("base", "huber", ("l11", "b11.x"), {"l12": (-1e-4, 2e-4)}, {"m": 3e-4, "l21": 1e-5})
    assert modelfile.loads(modelfile.dumps(replace(model, options=how))).options == how
    assert "options" not in tomllib.loads(modelfile.dumps(model))
    assert modelfile.loads(modelfile.dumps(model)).options == FitOptions()


def test_going_back_brings_back_how_a_step_was_fitted(model):
    held = replace(model, options=FitOptions(fixed=("l11",)), time_origin=3600.0)
    steps = [modelfile.snapshot(m, "fit") for m in (held, replace(held, options=FitOptions(loss="huber")))]
    back = modelfile.loads(modelfile.dumps(replace(held, options=FitOptions("base"), history=tuple(steps))))
    assert back.time_origin == 3600.0
    assert modelfile.restore(back, back.history[0]).options == FitOptions(fixed=("l11",))
    assert modelfile.restore(back, back.history[1]).options == FitOptions(loss="huber")


def test_a_bare_model_stays_bare(delta, perturb):
    bare = Model.nominal(delta).with_geometry(perturb(41))
    back = modelfile.loads(modelfile.dumps(bare))
    same(bare, back)
    assert back.sigma is None and back.frame is None and back.effects == () and back.history == ()


def test_the_file_stands_alone(model, tmp_path, monkeypatch):
    """Its robot is in it, whole: masses, workspace, gravity."""
    modelfile.save(tmp_path / "m.toml", model)
    monkeypatch.chdir(tmp_path)
    robot = modelfile.load("m.toml").robot
    for name in ("joint_min", "joint_max", "workspace", "mass"):
        assert getattr(robot, name) == getattr(model.robot, name)
    assert np.array_equal(robot.gravity, model.robot.gravity)


def test_effects_without_a_spec_keep_their_variant(delta):
    """Made in Python, not named on a command line: one number per arm stays one per arm."""
    for name, per in (("drive_compliance", "arm"), ("rod_compliance", "rod"), ("gear_ripple", "common")):
        effect = effects.get(name, per, delta)
        theta = np.arange(1.0, 1 + len(effect.parameters)) * 1e-6
        made = replace(Model.nominal(delta), effects=(FittedEffect(effect, theta),))
        back = modelfile.loads(modelfile.dumps(made)).effects[0]
        assert back.effect == effect
        np.testing.assert_allclose(back.theta, theta, rtol=1e-14)


def test_every_effect_of_the_library(delta):
    for name in effects.names():
        for per in effects.get(name).variants:
            effect = effects.get(name, per, delta)
            made = replace(Model.nominal(delta), effects=(fitted(delta, effect.spec),))
            same(made, modelfile.loads(modelfile.dumps(made)))


def test_history_takes_back(model, delta, perturb, measure, tmp_path):
    """A fit, then an effect added: the file restores each step without data."""
    truth = Model.nominal(delta).with_geometry(perturb(42))
    data = measure(truth, 60, payload=np.linspace(0, 2, 60))
    first = identification.fit(data, delta)
    one = replace(first.model, history=(modelfile.snapshot(first.model, "fit", rms_um=np.float64(20.0), note=None),))
    drive = fitted(delta, "drive_compliance")
    second = identification.fit(data, one, effects=[replace(drive, theta=np.zeros(1))])
    two = replace(
        second.model, history=(*one.history, modelfile.snapshot(second.model, "add", effect="drive_compliance"))
    )
    modelfile.save(tmp_path / "m.toml", replace(two, frame=FRAME), summary.statistics(second))
    back = modelfile.load(tmp_path / "m.toml")
    assert [h["action"] for h in back.history] == ["fit", "add"]
    assert back.history[0]["rms_um"] == 20.0 and "note" not in back.history[0]
    was = modelfile.restore(back, back.history[0])
    assert np.array_equal(was.k, first.model.k) and was.effects == () and was.frame is None
    assert was.history == back.history and was.sigma is None
    now = modelfile.restore(back, back.history[1])
    assert np.array_equal(now.k, second.model.k)
    assert now.effects[0].theta == pytest.approx(second.model.effects[0].theta, rel=1e-14)
    framed = modelfile.snapshot(replace(two, frame=FRAME), "fit")
    frame = modelfile.restore(back, framed).frame
    assert frame is not None and np.abs(frame.rotation - FRAME.rotation).max() < 1e-15
    for damage in ({"k_si": [1.0]}, {"k_si": "all"}, {"level": 3}, {"effects": [1]}, {"frame": {}}):
        with pytest.raises(InputError):
            modelfile.restore(back, dict(back.history[1]) | damage)


# --- broken and hostile files -----------------------------------------------------------------------------------------


ABSENT = object()


def put(*path):
    """How to break a model's table: path[-1] at the keys before it, or nothing there where that is ABSENT."""
    *keys, last, value = path

    def make(table):
        node = table
        for key in keys:
            node = node[key]
        node[last] = value
        if value is ABSENT:
            del node[last]
        return tomli_w.dumps(table)

    return make


BROKEN = {
    "not TOML": (lambda _: "name = [", "not valid TOML"),
    "nested too deep": (lambda _: "a = " + "[" * 100_000, "not valid TOML"),
    "another file": (lambda _: 'name = "delta"', "not a model file .no schema"),
    "another schema": (put("schema", "pcalib.model/9"), "schema 'pcalib.model/9'"),
    "schema of another type": (put("schema", [1]), "not a model file"),
    "no robot": (put("robot", ABSENT), "robot is missing"),
    "robot is a number": (put("robot", 3), "robot"),
    "robot of no kind": (put("robot", "kind", "scara"), "unknown robot kind 'scara'"),
    "huge number in the robot": (put("robot", "geometry", "rod_length_mm", 10**400), "rod_length_mm"),
    "no parameters": (put("parameters", ABSENT), "parameters is missing"),
    "parameter of another robot": (put("parameters", "l99", {"value_mm": 1.0}), "parameter 'l99'"),
    "parameter is a number": (put("parameters", "l11", 800.0), "l11"),
    "value is text": (put("parameters", "l11", "value_mm", "long"), "l11"),
    "value is true": (put("parameters", "l11", "value_mm", True), "l11"),
    "value is not finite": (put("parameters", "l11", "value_mm", float("nan")), "l11"),
    "value is huge": (put("parameters", "l11", "value_mm", 10**400), "l11"),
    "value in another unit": (put("parameters", "l11", {"value_inch": 31.5}), "l11"),
    "value is absent": (put("parameters", "l11", ABSENT), "l11"),
    "sigma is negative": (put("parameters", "l11", "sigma_mm", -1.0), "l11"),
    "level unknown": (put("level", "perfect"), "level 'perfect' is not one of"),
    "level is a list": (put("level", [1]), "level"),
    "no level": (put("level", ABSENT), "level None is not one of nominal, "),
    "effects are text": (put("effects", "all"), "effects"),
    "effect unknown": (put("effects", [{"spec": "ghosts"}]), "unknown effect 'ghosts'"),
    "effect without values": (put("effects", [{"spec": "backlash"}]), "backlash"),
    "effect not finite": (put("effects", [{"spec": "backlash", "gap_arcmin": float("inf")}]), "backlash"),
    "effect spec is a number": (put("effects", [{"spec": 1}]), "spec"),
    "frame is short": (put("frame", "translation_mm", [1.0, 2.0]), "'translation_mm' must be a list of 3 numbers"),
    "frame is not finite": (put("frame", "rotation_deg", [0.0, float("nan"), 0.0]), "frame"),
    "frame lacks a key": (put("frame", "target_offset_mm", ABSENT), "frame"),
    "time is text": (put("time_origin_s", "noon"), "'time_origin_s' must be a number"),
    "options are text": (put("options", "all"), "options is missing, or is no table"),
    "option unknown": (put("options", {"speed": 1}), "unknown key 'speed'"),
    "method unknown": (put("options", {"method": "guess"}), "unknown method 'guess'"),
    "method is a number": (put("options", {"method": 3}), "unknown method '3'"),
    "fixed is text": (put("options", {"fixed": "l11"}), "fixed is no list"),
    "fixed is no parameter": (put("options", {"fixed": ["l99"]}), "unknown parameter of level complete 'l99'"),
    "bound is no parameter": (put("options", {"bounds_si": {"l77": [0.0, 1e-4]}}), "'l77'"),
    "bounds are reversed": (put("options", {"bounds_si": {"l11": [1e-4, -1e-4]}}), "l11: the low bound is not below"),
    "bounds are short": (put("options", {"bounds_si": {"l11": [1.0]}}), "bounds_si: l11 must be 2"),
    "prior is negative": (put("options", {"prior_si": {"m": -1.0}}), "prior_si: m is negative"),
    "history is text": (put("history", "long ago"), "history"),
    "history of numbers": (put("history", [1, 2]), "history"),
}


@pytest.mark.parametrize(("make", "says"), BROKEN.values(), ids=BROKEN)
def test_broken_files_are_refused_in_a_sentence(model, tmp_path, make, says):
    path = tmp_path / "m.toml"
    path.write_text(make(tomllib.loads(modelfile.dumps(model))), "utf-8")
    with pytest.raises((InputError, EffectError), match=says) as caught:
        modelfile.load(path)
    assert str(path) in str(caught.value) or isinstance(caught.value, EffectError)
    assert "Traceback" not in str(caught.value)


def test_files_that_are_none(tmp_path):
    for path, says in ((tmp_path / "absent.toml", "no such file"), (tmp_path, "is a directory")):
        with pytest.raises(InputError, match=says):
            modelfile.load(path)
    (tmp_path / "latin.toml").write_bytes('name = "Größe"'.encode("latin-1"))
    with pytest.raises(InputError, match="not UTF-8"):
        modelfile.load(tmp_path / "latin.toml")


def test_nothing_half_written(model, tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        modelfile.save(tmp_path / "no" / "m.toml", model)
    path = tmp_path / "m.toml"
    path.write_text("precious")
    with pytest.raises(TypeError):
        modelfile.save(path, model, {"bad": object()})
    assert path.read_text() == "precious" and [p.name for p in tmp_path.iterdir()] == ["m.toml"]


SCALARS = st.one_of(st.none(), st.booleans(), st.integers(-(10**30), 10**30), st.floats(), st.text(max_size=8))
VALUES = st.recursive(
    SCALARS.filter(lambda v: v is not None),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
    max_leaves=5,
)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_value_anywhere_is_read_or_refused(model, data):
    """Fuzz: one entry of a good file replaced by anything gives a model of finite numbers or an error."""
    table = tomllib.loads(modelfile.dumps(model))
    node, keys = table, []
    while (
        isinstance(node, dict) and node and (not keys or data.draw(st.booleans() if len(keys) > 1 else st.just(True)))
    ):
        keys.append(data.draw(st.sampled_from(sorted(node))))
        node = node[keys[-1]]
    value = data.draw(VALUES)
    text = put(*keys, value)(table)
    try:
        found = modelfile.loads(text)
    except PcalibError:
        return
    assert np.isfinite(found.k).all()
    assert all(np.isfinite(f.theta).all() for f in found.effects)
    assert found.frame is None or np.isfinite(found.frame.rotation).all()


# --- effects of the user's own ----------------------------------------------------------------------------------------

OWN = """
from dataclasses import dataclass
import numpy as np
from pcalib.effects.base import Contribution, EffectParameter
{trap}

@dataclass(frozen=True)
class WormGear:
    name = "worm_gear"
    linear = True
    parameters = (EffectParameter("lead", "urad", 1e-4),)
    needs = ()

    def contribution(self, at, theta):
        return Contribution(actuator=theta[0] * np.sin(at.q))
"""


def test_code_is_loaded_only_when_named(delta, tmp_path):
    """A model file may name a file of code; reading the model never runs it unless the caller names it too."""
    trap = tmp_path / "ran"
    own = tmp_path / "worm.py"
    own.write_text(OWN.format(trap=f"open({str(trap)!r}, 'a').write('x')"))
    spec = f"{own}:WormGear"
    effect = effects.parse(spec, delta)
    model = replace(Model.nominal(delta), effects=(FittedEffect(effect, np.array([3e-4]), spec),))
    entry = modelfile.snapshot(model, "add")
    path = tmp_path / "m.toml"
    modelfile.save(path, replace(model, history=(entry,)))
    trap.unlink()
    with pytest.raises(EffectError, match="code is loaded only when you name it") as caught:
        modelfile.load(path)
    assert "add --effect " in str(caught.value) and not trap.exists()
    with pytest.raises(EffectError, match="code is loaded only when you name it"):
        modelfile.load(path, [str(tmp_path / "other.py") + ":WormGear"])
    with pytest.raises(EffectError, match="code is loaded only when you name it"):
        modelfile.load(path, [f"{own}:Another"])
    assert not trap.exists()
    back = modelfile.load(path, [spec])
    assert trap.exists() and back.effects[0].theta == pytest.approx([3e-4], rel=1e-14)
    with pytest.raises(EffectError, match="code is loaded only when you name it"):
        modelfile.restore(back, back.history[0])
    assert modelfile.restore(back, back.history[0], [spec]).effects[0].theta == pytest.approx([3e-4], rel=1e-14)


def test_a_file_cannot_point_at_other_code(delta, tmp_path):
    """The file's own path never matters: of two files of one name, the one that is named is loaded."""
    good, evil = tmp_path / "good", tmp_path / "evil"
    for folder in (good, evil):
        folder.mkdir()
    ran = tmp_path / "ran"
    (good / "worm.py").write_text(OWN.format(trap=""))
    (evil / "worm.py").write_text(OWN.format(trap=f"open({str(ran)!r}, 'a').write('x')"))
    effect = effects.parse(f"{good / 'worm.py'}:WormGear", delta)
    text = modelfile.dumps(
        replace(Model.nominal(delta), effects=(FittedEffect(effect, np.zeros(1), f"{evil / 'worm.py'}:WormGear"),))
    )
    modelfile.loads(text, effect_files=[f"{good / 'worm.py'}:WormGear"])
    assert not ran.exists()
