"""The examples of CONTRIBUTING.md work as they stand: an effect and a fault that agree, and a command."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from bench.commands import Commands
from bench.machine import Machine
from pcalib import prediction
from pcalib.effects.library import Places
from pcalib.model import FittedEffect, Model
from pcalib.prediction import Conditions

TEXT = (Path(__file__).resolve().parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")


@pytest.fixture
def example(monkeypatch):
    """example(name, holding): the module that the block with this text defines, under its name."""

    def load(name: str, holding: str) -> ModuleType:
        (code,) = (block for block in re.findall(r"```python\n(.*?)```", TEXT, re.S) if holding in block)
        module = ModuleType(name)
        monkeypatch.setitem(sys.modules, name, module)
        exec(compile(code, f"{name}.py", "exec"), vars(module))
        return module

    return load


def test_the_effect_is_what_the_fault_does(example, delta):
    fault = example("bench.faults.worm_error", "FAULT =").FAULT(delta, amplitude=np.full(3, 2e-4))
    effect = example("pcalib.effects.worm_error", "EFFECT =").EFFECT(places=Places.of(delta.mechanism))
    assert fault.name == effect.name == "worm_error" and effect.describe(np.array([2e-4])) == "amplitude 200 µrad"
    q = np.random.default_rng(0).uniform(-0.8, 0.3, (20, 3))
    model = replace(Model.nominal(delta), effects=(FittedEffect(effect, np.array([2e-4])),))
    landed = Machine(delta, None, [fault]).run(Commands.of(q)).tcp
    assert np.abs(landed - prediction.predict(model, q, Conditions.of(20)).position).max() < 1e-9
    assert np.abs(landed - Machine(delta).land(q).tcp).max() > 1e-5


def test_the_command_counts(example, tmp_path, capsys):
    (tmp_path / "data.csv").write_text("q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n0,0,0,0,0,-800\n1,1,1,0,0,-801\n")
    example("pcalib.cli.count", "def command").command(tmp_path / "data.csv", json=tmp_path / "count.json")
    assert capsys.readouterr().out == "2 rows.\n" and '"rows": 2' in (tmp_path / "count.json").read_text()
