"""The LinuxCNC module is one that halcompile accepts, and says what pcalib says, in millimetres and degrees."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess

import numpy as np
import pytest

from pcalib import rotation
from pcalib.export import linuxcnc
from pcalib.mechanics import kinematics
from pcalib.workspace import reachable

needs_halcompile = pytest.mark.skipif(
    shutil.which("halcompile") is None, reason="halcompile is not here (Debian: linuxcnc-uspace-dev)"
)


def test_the_module_has_what_linuxcnc_asks_for(built):
    ((name, text),) = linuxcnc.write(built).items()
    assert name == "pcalibkins.c" and '#include "pcalib_robot.h"' not in text
    for asked in ("kinematicsForward(", "kinematicsInverse(", "kinematicsType(", "rtapi_app_main(", "KINS_NOT_"):
        assert asked in text


@needs_halcompile
def test_halcompile_accepts_it_and_it_agrees(built, tmp_path):
    for name, text in linuxcnc.write(built).items():
        (tmp_path / name).write_text(text)
    done = subprocess.run(["halcompile", "--compile", "pcalibkins.c"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    module = ctypes.CDLL(str(tmp_path / "pcalibkins.so"), mode=os.RTLD_LAZY)
    mechanism = built.robot.mechanism
    unit = np.pi / 180 if mechanism.actuator_dimension == "angle" else 1e-3
    q = reachable(built.robot, 20, np.random.default_rng(3)).q
    known = kinematics.forward(mechanism, built.k, q)
    for n in range(len(q)):
        joint, world, back = np.ascontiguousarray(q[n] / unit), np.zeros(9), np.zeros(q.shape[1])
        flags = ctypes.c_ulong(0)

        def at(values: np.ndarray) -> ctypes.c_void_p:
            return values.ctypes.data_as(ctypes.c_void_p)

        assert module.kinematicsForward(at(joint), at(world), ctypes.byref(flags), ctypes.byref(flags)) == 0
        np.testing.assert_allclose(world[:3], 1e3 * known.pose.x[n], rtol=0, atol=1e-8)
        if {3, 4} <= set(mechanism.task):
            x, y, z = (rotation.about(axis, np.radians(a)) for axis, a in zip(np.eye(3), world[3:6], strict=True))
            np.testing.assert_allclose(z @ y @ x, known.pose.R[n], rtol=0, atol=1e-11)
        assert module.kinematicsInverse(at(world), at(back), ctypes.byref(flags), ctypes.byref(flags)) == 0
        if len(mechanism.task) == 3 or {3, 4} <= set(mechanism.task):  # what the task prescribes decides the commands
            np.testing.assert_allclose(back * unit, q[n], rtol=0, atol=1e-10)
