"""The exported structured text, run statement by statement, says what pcalib says; a parser of PLC code accepts it."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from pcalib import rotation
from pcalib.export import st
from pcalib.mechanics import kinematics

FILES = Path(__file__).parents[2] / "models"
spec = importlib.util.spec_from_file_location("structured_text", Path(__file__).with_name("structured_text.py"))
assert spec is not None and spec.loader is not None
structured_text = importlib.util.module_from_spec(spec)
spec.loader.exec_module(structured_text)


def test_its_self_test_passes(built, with_effects, monkeypatch):
    monkeypatch.setattr(st, "TESTED", 8)
    known = structured_text.load("\n".join(st.write(with_effects(built)).values()))
    program = known["PCALIB_SelfTest"]()
    program()
    assert program.passed and program.wrong == 0
    assert program.worst < 1e-11  # as the C; on a PLC its own functions decide
    program.T_position[0] += 1e-6
    program()
    assert not program.passed  # it can fail


def test_targets_out_of_reach_have_the_status_that_pcalib_gives_them(built):
    robot, rng, n = built.robot, np.random.default_rng(7), 12
    w, mechanism = robot.workspace, robot.mechanism
    high, wide = 2 * (w.z_max - w.z_min), 2 * w.radius
    x = np.column_stack([*rng.uniform(-wide, wide, (2, n)), rng.uniform(w.z_min - high, w.z_max + high, n)])
    R = rotation.exp(np.zeros((n, 3)))
    known = kinematics.inverse(mechanism, built.k, x, R)
    block = structured_text.load(st.write(built)["PCALIB_Robot.st"])["PCALIB_Robot"]()
    block.backward = True
    found = []
    for target in x:
        block.target[:] = target
        block()
        found.append(int(block.status))
    expected = [{"ok": (0, 3), "not_converged": (1,), "wrong_branch": (2,)}[s] for s in known.status]
    assert all(f in e for f, e in zip(found, expected, strict=True)), (found, known.status)


def test_numbers_are_written_as_the_standard_has_them():
    assert [st.number(v) for v in (3, 1.0, 1e-14, -2.5e22, 0.1)] == ["3", "1.0", "1.0E-14", "-2.5E22", "0.1"]


@pytest.mark.parametrize("built", [FILES / "planar.toml"], indirect=True)  # all have one kernel; this, the least table
def test_a_parser_of_plc_code_accepts_it(built, with_effects, monkeypatch):
    parse = pytest.importorskip("blark.parse", reason="blark, a parser of structured text, is not installed")
    monkeypatch.setattr(st, "TESTED", 1)
    for text in st.write(with_effects(built)).values():
        assert parse.parse_source_code(text).exception is None
    assert parse.parse_source_code("PROGRAM x\nIF THEN\nEND_PROGRAM").exception is not None
