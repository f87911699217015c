"""The exported MJCF: MuJoCo lands where pcalib says, and holds the robot where it is commanded."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from pcalib import rotation
from pcalib.errors import EffectError
from pcalib.export import mjcf
from pcalib.export.rods import rods_of
from pcalib.mechanics import kinematics
from pcalib.workspace import reachable


def loaded(model):
    (text,) = mjcf.write(model).values()
    found = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(found)
    mujoco.mj_resetDataKeyframe(found, data, 0)
    mujoco.mj_forward(found, data)
    return found, data


def close(model: mujoco.MjModel, data: mujoco.MjData, driven: list[int], values: np.ndarray) -> float:
    """Newton on MuJoCo's own constraint residual with the drives held; the largest error left [m]."""
    free = np.setdiff1d(np.arange(model.nv), model.jnt_dofadr[driven])
    data.qpos[model.jnt_qposadr[driven]] = values
    for _ in range(20):
        mujoco.mj_fwdPosition(model, data)
        error = data.efc_pos[: data.ne].copy()
        if np.abs(error).max() < 1e-13:
            break
        J = data.efc_J.reshape(-1, model.nv)[: data.ne] if not mujoco.mj_isSparse(model) else dense(model, data)
        step = np.zeros(model.nv)
        step[free] = np.linalg.lstsq(J[:, free], -error, rcond=None)[0]
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    return float(np.abs(error).max())


def dense(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    out = np.zeros((data.ne, model.nv))
    mujoco.mju_sparse2dense(out, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    return out


def test_it_lands_where_pcalib_says(built):
    model, data = loaded(built)
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-12  # the loops are closed at home
    ratio = mjcf.ratios(rods_of(built))
    driven = [model.joint(name).id for name in built.robot.mechanism.actuators]
    home = data.qpos[model.jnt_qposadr[driven]] / ratio
    q = reachable(built.robot, 8, np.random.default_rng(2)).q
    known = kinematics.forward(built.robot.mechanism, built.k, q)
    for n in range(len(q)):
        for share in np.linspace(0, 1, 9)[1:]:  # from home in steps, as a robot moves
            left = close(model, data, driven, (home + share * (q[n] - home)) * ratio)
        assert left < 1e-12
        site = data.site("tool")
        np.testing.assert_allclose(site.xpos, known.pose.x[n], rtol=0, atol=1e-10)
        np.testing.assert_allclose(site.xmat.reshape(3, 3), known.pose.R[n], rtol=0, atol=1e-9)
        home = q[n]


def test_it_stands_where_it_is_commanded(built):
    """The drives' gains are soft, so that the weight of plate and arms lets them yield by some millimetres at most."""
    model, data = loaded(built)
    start = data.site("tool").xpos.copy()
    np.testing.assert_allclose(data.sensor("q1").data, data.ctrl[0], atol=1e-9)
    for _ in range(400):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all() and not any(w.number for w in data.warning)
    assert np.linalg.norm(data.site("tool").xpos - start) < 3e-3
    assert abs(np.linalg.norm(data.sensor("tool_rotation").data) - 1) < 1e-9
    assert rotation.from_quaternion(data.sensor("tool_rotation").data)[2, 2] > 0.99


def test_effects_are_refused_by_name(built, with_effects):
    with pytest.raises(EffectError, match=r"cannot be written as MJCF"):
        mjcf.write(with_effects(built))
