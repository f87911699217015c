"""docs/bench.md says what the bench does: faults and settings as they are, examples that run."""

import re

import numpy as np

from bench import faults, noises
from bench import truth as truths
from bench.faults import Fault
from bench.instrument import SETTINGS
from bench.jobs import fault_fields
from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import robot as robots
from pcalib.settings import Setting

ROBOT = robots.load(MODELS / "delta.toml")
TEXT = (fault_fields.DOCS / "bench.md").read_text(encoding="utf-8")


def block(language, holding):
    return next(b for b in re.findall(rf"```{language}\n(.*?)```", TEXT, re.S) if holding in b)


def test_the_chapter_on_faults_is_up_to_date(own_tests):
    described = set(re.findall(r"^### ([a-z_]+)$", TEXT, re.M)) & {*faults.names()}
    assert set(faults.names()) <= described | own_tests and len(described) > 25
    for name in described:
        assert fault_fields.describe(ROBOT, name) in TEXT, "run python -m bench.jobs.fault_fields"
        assert (fault_fields.DOCS / "faults" / f"{name}.png").stat().st_size > 5000


def test_every_setting_of_an_instrument_is_described(own_tests):
    own = {s.name for name in noises.names() if name in own_tests for s in noises.get(name).SETTINGS}
    missing = [s.name for s in SETTINGS if s.name not in own and not re.search(rf"`{s.name}(_[A-Za-z]+)?`", TEXT)]
    assert not missing, f"docs/bench.md says nothing of {', '.join(missing)}"


def test_the_truth_file_shown_is_a_truth_file():
    text = block("toml", "[geometry.errors]").replace('"models/delta.toml"', f'"{MODELS / "delta.toml"}"')
    truth = truths.parse(text)
    assert {fault.name for fault in truth.faults} == {"drive_compliance", "backlash"}
    assert abs(truth.faults[0].values["compliance"][2] - 20e-6) < 1e-12 and truth.errors.all()


def test_the_fault_shown_works():
    space = {"Fault": Fault, "Setting": Setting}
    exec(block("python", "class Slip"), space)
    slip = space["FAULT"](ROBOT, angle=np.full(3, 1e-3))
    q = np.array([[0.1, -0.2, -0.3]])
    assert np.allclose(Machine(ROBOT, None, [slip]).land(q).tcp, Machine(ROBOT).land(q - 1e-3).tcp, atol=1e-12)


def test_a_field_shows_what_the_fault_does():
    above, side = fault_fields.fields(ROBOT, "thermal_base")
    assert len(above.x) > 30 and len(side.x) > 30 and np.isfinite(above.d).all()
    grown = 12e-6 * 10
    # A base that grows by ε acts as one by 1 + ε with everything else shrunk: its motors move out by 24 µm.
    assert 0.2 * grown * 0.2 < np.abs(above.d).max() < 5 * grown * 0.2
