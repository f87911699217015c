"""A campaign on a real dask cluster: a scheduler and two workers on loopback, one of them killed on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from bench.cli import main
from bench.jobs import running, study
from bench.jobs.campaign import spec
from bench.jobs.campaign.study import Campaign
from pcalib.errors import InputError

distributed = pytest.importorskip("distributed")
ROOT = Path(__file__).parents[3]
WAIT = 300
"""[s] after which a program hangs; a busy machine may take a hundred times as long as an idle one."""


@dataclass
class Cluster:
    """Processes of a dask cluster."""

    address: str
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory) -> Iterator[Cluster]:
    folder = tmp_path_factory.mktemp("cluster")
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}

    def start(what: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *options, "--no-dashboard"]
        return subprocess.Popen(command, cwd=folder, env=env, stderr=subprocess.DEVNULL)

    address_file = folder / "address.json"
    started = [start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(address_file))]
    try:
        deadline = time.monotonic() + WAIT
        while not address_file.exists():
            assert started[0].poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        more = ("--scheduler-file", str(address_file), "--nthreads", "1", "--no-nanny", "--host", "127.0.0.1")
        workers = [start("worker", *more, "--local-directory", str(folder / str(i))) for i in range(2)]
        started += workers
        address = json.loads(address_file.read_text())["address"]
        with distributed.Client(address, timeout=WAIT, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=WAIT)
        yield Cluster(address, workers)
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


def test_the_same_bytes_although_a_worker_is_killed(written, tmp_path, cluster):
    campaign = spec.load(written(robots="robots = 40", part_robots="part_robots = 1"))
    running.run(Campaign(campaign), tmp_path / "here", 1)
    done = 0

    def progress(robots: int) -> None:
        nonlocal done
        done += robots
        if done == 5:
            cluster.workers[0].send_signal(signal.SIGKILL)

    outcome = running.run(Campaign(campaign), tmp_path / "there", scheduler=cluster.address, progress=progress)
    assert cluster.workers[0].wait() == -signal.SIGKILL and cluster.workers[1].poll() is None
    assert outcome.trials == done == 40
    for name in ("results.parquet", "campaign.json"):
        assert (tmp_path / "there" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


def test_from_the_command_line(written, tmp_path, cluster, capsys):
    folder = tmp_path / "out"
    assert main(["campaign", str(written()), "-o", str(folder), "--scheduler", cluster.address, "--no-figures"]) == 0
    assert "6 robots in" in capsys.readouterr().out
    running.run(Campaign(spec.load(written())), tmp_path / "here", 1)
    assert (folder / "results.parquet").read_bytes() == (tmp_path / "here" / "results.parquet").read_bytes()


def test_workers_with_other_versions_are_refused(written, tmp_path, cluster, monkeypatch):
    ours = study.versions()
    monkeypatch.setattr(distributed.Client, "run", lambda *_a, **_k: {"tcp://there": {**ours, "mujoco": "3.0"}})
    with pytest.raises(InputError, match="worker tcp://there has mujoco 3"):
        running.run(Campaign(spec.load(written())), tmp_path / "out", scheduler=cluster.address)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense"])
def test_no_scheduler_there(written, tmp_path, capsys, address, monkeypatch):
    monkeypatch.setattr("bench.jobs.running.CONNECT", 0.5)
    assert main(["campaign", str(written()), "-o", str(tmp_path / "out"), "--scheduler", address]) == 2
    message = capsys.readouterr().err
    assert f"no dask scheduler at {address}" in message and "tcp://HOST:PORT" in message and "Traceback" not in message
