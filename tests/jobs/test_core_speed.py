"""The benchmark's figures mean what they say; the toolbox beside it solves the same problem."""

import json

import numpy as np
import pytest

from bench.jobs.speed import core_speed, peer_sysid
from bench.jobs.speed.timing import Cost
from pcalib.fitting import identification


def test_figures_keep_their_bounds_either_way():
    assert Cost("a", 9.0, "ms", 10.0).holds and not Cost("a", 11.0, "ms", 10.0).holds
    assert Cost("a", 31.0, "times", 30.0, at_least=True).holds
    assert not Cost("a", 29.0, "times", 30.0, at_least=True).holds
    assert Cost("a", 1e9, "s").holds
    assert Cost("a", 1, "ms", 10.0).promise == "≤ 10 ms"


def test_the_command_prints_and_writes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(core_speed, "ROBOTS", 1)
    code = core_speed.main(["--quick", "--repeats", "1", "--no-peers", "--json", str(tmp_path / "b.json")])
    said = json.loads((tmp_path / "b.json").read_text())
    assert said["schema"] == "pcbench.core_speed/1"
    assert code == (0 if all(f["holds"] for f in said["figures"]) else 1)
    names = [f["name"] for f in said["figures"]]
    out = capsys.readouterr().out
    assert all(name in out for name in names) and "left out" in out
    assert {"exact compensation", "pcalib --help"} <= set(names)


@pytest.mark.skipif(bool(peer_sysid.missing()), reason="needs mujoco-core[sysid]")
def test_the_toolbox_finds_the_same_robot(delta):
    """Given the closure residual; the settling rollouts take minutes and are left to the benchmark."""
    (data,) = core_speed.data_sets(delta, 60, 1)
    own = identification.fit(data, delta, prior_scale=1.0).model.k
    found = peer_sysid.by_closure(delta, data, "scipy")
    nominal = delta.mechanism.nominal
    assert found.evaluations > 60
    assert core_speed.apart(delta, own, nominal) > 2e-4
    assert core_speed.apart(delta, own, found.k) < 1e-5  # rods' errors weigh a little differently from readings
    assert np.isfinite(found.k).all()
