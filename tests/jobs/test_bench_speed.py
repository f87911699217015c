"""The timings of the virtual robot: here only that its check of the bytes can fail."""

from __future__ import annotations

from types import SimpleNamespace

from bench import simulate
from bench.jobs.speed import bench_speed


def test_the_same_bytes_are_made_by_workers_that_share_the_rows(monkeypatch):
    """Quick or not: rows of a single piece are all done by one."""
    asked: list[int] = []
    for name in ("rigid", "equilibrium", "family", "data_sets"):
        monkeypatch.setattr(bench_speed, name, lambda *_: [])
    made = SimpleNamespace(measurements=None)
    monkeypatch.setattr(bench_speed, "measure", lambda truth, rows, workers: asked.append(rows) or made)
    monkeypatch.setattr(bench_speed.measurement, "save", lambda path, data: path.write_text("the same"))
    assert bench_speed.command(quick=True) == 0
    assert len(asked) == len(bench_speed.WORKERS) and min(asked) > simulate.CHUNK
