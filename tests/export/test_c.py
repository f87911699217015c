"""The exported C against pcalib's own NumPy: its self-test, strict compilers, and statuses far from the workspace."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import effects, rotation
from pcalib.errors import EffectError
from pcalib.export import TARGETS, c
from pcalib.mechanics import kinematics
from pcalib.model import FittedEffect, Model
from pcalib.workspace import allowed

FILES = sorted((Path(__file__).parents[2] / "models").glob("*.toml"))
COMPILER = shutil.which("cc") or shutil.which("gcc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc, gcc) on this machine")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
MANY = """
#include "pcalib_robot.h"
void inverse(long n, const double *x, const double *R, const double *t, double *q, int *status)
{
    long i;
    for (i = 0; i < n; i++) status[i] = pcalib_inverse(x + 3 * i, R + 9 * i, t, 0, q + PCALIB_DRIVES * i);
}
void forward(long n, const double *q, const double *t, double *x, int *status)
{
    long i, c;
    for (i = 0; i < n; i++) {
        pcalib_pose pose;
        status[i] = pcalib_forward(q + PCALIB_DRIVES * i, t, 0, &pose);
        for (c = 0; c < 3; c++) x[3 * i + c] = pose.position[c];
    }
}
"""


def compiled(folder: Path, sources: list[str], output: str, *options: str) -> Path:
    assert COMPILER is not None
    command = [COMPILER, *STRICT, "-O3", *options, "-o", output, *sources, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / output


def put(model: Model, folder: Path) -> None:
    for name, text in c.write(model).items():
        (folder / name).write_text(text, encoding="utf-8")


@needs_compiler
def test_the_self_test_agrees(built, with_effects, tmp_path):
    put(with_effects(built), tmp_path)
    program = compiled(tmp_path, ["self_test.c", "pcalib_robot.c"], "self_test")
    done = subprocess.run([program], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "100 poses" in done.stdout and "0 wrong statuses" in done.stdout


@needs_compiler
@pytest.mark.parametrize("built", [f for f in FILES if f.stem in ("delta", "h4", "hexapod")], indirect=True)
def test_no_undefined_behaviour(built, with_effects, tmp_path):
    put(with_effects(built), tmp_path)
    checks = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    program = compiled(tmp_path, ["self_test.c", "pcalib_robot.c"], "self_test", *checks)
    assert subprocess.run([program], capture_output=True).returncode == 0


@needs_compiler
def test_poses_far_and_near_have_the_status_that_pcalib_gives_them(built, tmp_path):
    """Targets in a cylinder much larger than the workspace: some cannot be reached, some only turned over."""
    put(built, tmp_path)
    (tmp_path / "many.c").write_text(MANY)
    library = ctypes.CDLL(str(compiled(tmp_path, ["many.c", "pcalib_robot.c"], "many.so", "-shared", "-fPIC")))
    robot, rng, n = built.robot, np.random.default_rng(6), 1500
    mechanism, w = robot.mechanism, robot.workspace
    height = w.z_max - w.z_min
    x = np.column_stack([
        *rng.uniform(-1.5 * w.radius, 1.5 * w.radius, (2, n)), rng.uniform(w.z_min - height, w.z_max + height, n)
    ])  # fmt: skip
    turn = np.zeros((n, 3))
    commanded = [a for a in (3, 4, 5) if a in mechanism.task]
    turn[:, [a - 3 for a in commanded]] = 0.3 * rng.standard_normal((n, len(commanded)))
    R, tool = rotation.exp(turn), 0.1 * mechanism.tool_direction
    q, status = np.zeros((n, len(mechanism.actuators))), np.zeros(n, np.int32)
    library.inverse(ctypes.c_long(n), *(a.ctypes.data_as(ctypes.c_void_p) for a in (x, R, tool, q, status)))
    known = kinematics.inverse(mechanism, built.k, x, R if commanded else None, tool)
    ok, mine = known.ok, np.isin(status, (0, 3))
    if mechanism.kind == "planar":  # a few poses at the end of its reach are found from another start
        assert (mine | ~ok).all() and np.mean(mine != ok) < 0.01
    else:
        np.testing.assert_array_equal(mine, ok)
    np.testing.assert_array_equal(status == 2, known.status == "wrong_branch")
    within = ok & allowed(robot, known.q, known.pose, known.status)
    assert within.sum() > 10
    np.testing.assert_allclose(q[within], known.q[within], rtol=0, atol=1e-11)
    outside = ok & ((known.q < robot.joint_min - 1e-6) | (known.q > robot.joint_max + 1e-6)).any(axis=1)
    assert (status[outside] == 3).all()

    q, seen = np.ascontiguousarray(known.q[within]), np.zeros((int(within.sum()), 3))
    status = np.ones(len(q), np.int32)
    library.forward(ctypes.c_long(len(q)), *(a.ctypes.data_as(ctypes.c_void_p) for a in (q, tool, seen, status)))
    assert not status.any()
    solved = kinematics.forward(mechanism, built.k, q)
    np.testing.assert_allclose(seen, solved.pose.tcp(tool), rtol=0, atol=1e-12)


def test_effects_of_loads_are_refused_by_name(built):
    effect = effects.get("drive_compliance", None, built.robot)
    loaded = replace(built, effects=(FittedEffect(effect, np.full(len(effect.parameters), 1e-6), effect.spec),))
    with pytest.raises(EffectError, match=r"(?s)drive_compliance cannot be exported.*pcalib drop drive_compliance"):
        c.write(loaded)


def test_a_name_cannot_end_the_comment(built):
    evil = replace(built, robot=replace(built.robot, name="x */ int evil; /*\n#error"))
    for text in c.write(evil).values():
        assert "*/ int evil" not in text and "\n#error" not in text


def test_every_target_has_a_sentence_and_a_next_step():
    for name in TARGETS.names():
        target = TARGETS.get(name)
        assert target.about and "{folder}" in target.next
