"""Poses and targets of campaigns lie where they should."""

from __future__ import annotations

import numpy as np
import pytest

from bench.jobs.campaign import samples, spec, trial
from bench.jobs.study import seed
from pcalib.mechanics import kinematics


@pytest.mark.parametrize(("kind", "inside"), [("joint", 1.0), ("random", 1.0), ("random", 0.95)])
def test_poses_lie_where_they_should(written, delta, kind, inside):
    campaign = spec.load(written(poses=f'kind = "{kind}"\nposes = 200\ninside = {inside}'))
    q = samples.own(delta, campaign.cell(0).poses, seed(0, 0, trial.PLAN)).commands.q
    x = kinematics.forward(delta.mechanism, delta.mechanism.nominal, q).pose.x
    w = delta.workspace
    assert len(q) == 200 and w.contains(x).all()
    assert (q >= delta.joint_min - 1e-9).all() and (q <= delta.joint_max + 1e-9).all()
    radius = np.hypot(x[:, 0], x[:, 1])
    assert (radius <= inside * w.radius + 1e-9).all()
    assert (np.abs(x[:, 2] - (w.z_min + w.z_max) / 2) <= inside * (w.z_max - w.z_min) / 2 + 1e-9).all()
    if kind == "random":  # of the area, within half the radius; the reachable part is wider there
        assert np.mean(radius < 0.2) == pytest.approx(0.25, abs=0.17)


def test_rings_fill_the_working_cylinder(written, delta):
    campaign = spec.load(written(targets='places = "rings"'))
    points = samples.targets(delta, campaign.cell(0).verify, 0).x
    radius = np.hypot(points[:, 0], points[:, 1])
    assert len(np.unique(points.round(9), axis=0)) == len(points) == 365
    assert delta.workspace.contains(points).all()
    np.testing.assert_allclose(np.unique(radius.round(9)), 0.4 * np.arange(4) / 3, atol=1e-9)
    np.testing.assert_allclose(np.unique(points[:, 2]), np.linspace(-0.925, -0.675, 5))
    np.testing.assert_allclose(points[:, :2].mean(axis=0), 0, atol=1e-12)
