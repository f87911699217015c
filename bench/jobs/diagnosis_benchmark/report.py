"""The command of scripts/diagnosis_benchmark: run, tables, figures, JSON."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from bench import pool
from bench.jobs.diagnosis_benchmark import figures
from bench.jobs.diagnosis_benchmark import rows as known
from bench.jobs.diagnosis_benchmark.results import Results
from pcalib import files, modelfile
from pcalib import robot as robots
from pcalib.cli import frame
from pcalib.data import measurement
from pcalib.errors import InputError

WORKERS = 2
SHOWN = 4
"""Data sets that are named for each bound they speak against."""


def command(
    *, seed: int = 0, out: Path = Path("out/diagnosis_benchmark"), json: frame.JsonOption = None,
    robot: Path | None = None, workers: int = WORKERS,
    rows: Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative=())] = (),
    n: Annotated[int | None, Parameter(name="-n")] = None, replay: str | None = None, quick: bool = False,
) -> int:  # fmt: skip
    """Hide effects in MuJoCo's robots, diagnose the data, and compare the rates with the bounds.

    Rows: `noise` (nothing hidden, noise as instruments make it), `hidden` (one effect, two, and effects of no library,
    at visible sizes from 3 to 20 noise units), `added` (effects are added, and the compensated robots land in MuJoCo
    with their faults still in them), `steps`, `held_out` (rows that must be heard), `agreement` of the commands,
    `coverage` of intervals, `random_laws` and `proposals` of laws. Exit code 1 where a bound is missed by more than
    chance.

    Args:
        seed: The same seed gives the same data.
        out: Folder for the figures, and for the data set of --replay.
        robot: Robot file for the rows hidden and added; the default Delta where absent.
        workers: Processes.
        rows: Only these rows, or variants of a row, such as noise.correlated or hidden.pair.
        n: Only so many data sets of each variant.
        replay: Write one data set by its name, such as noise.white/7#2, with its model and robot, and diagnose nothing.
        quick: One data set of each variant, to see that everything runs.
    """
    if workers < 1 or seed < 0 or (n is not None and n < 1):
        raise InputError(f"--workers {workers} --seed {seed} -n {n}: use positive numbers")
    nominal = "" if robot is None else robots.load(robot).text
    if replay is not None:
        made = known.replay(replay, seed, nominal)
        out.mkdir(parents=True, exist_ok=True)
        measurement.save(out / "data.csv", made.data)
        modelfile.save(out / "model.toml", made.model)
        files.write_text(out / "robot.toml", made.model.robot.text)
        frame.say(f"{out}: data.csv, model.toml and robot.toml of {replay} ({made.about})")
        return frame.OK
    tasks = known.tasks(rows or known.names(), 1 if quick else n, nominal)
    begun, outcomes = time.monotonic(), []
    with frame.progress("data sets", sum(task.sets for task in tasks)) as advance:
        for task, judged in zip(tasks, pool.ordered(partial(known.run, seed=seed), tasks, workers), strict=True):
            outcomes += judged
            advance(task.sets)
    results = Results(tuple(outcomes), seed, time.monotonic() - begun)
    show(results)
    if not rows and not quick:
        for path in figures.save(results, out):
            print(path)
    frame.write_json(json, results.to_json())
    broken = [line for line in results.lines if line.verdict == "falls short"]
    return frame.NOT_HELD if broken and not quick else frame.OK


def show(found: Results) -> None:
    """Print the tables."""
    lines = found.lines
    bound = [line for line in lines if line.verdict != "for comparison"]
    held = sum(line.holds for line in bound)
    took = f"{len(found.outcomes)} data sets in {found.seconds / 60:.1f} minutes"
    frame.say(f"{took}; {held} of {len(bound)} bounds hold.")
    frame.show_table(
        ("", "bound", "figure", "±σ", "of", "verdict"),
        [
            (
                line.what,
                f"{'≤' if line.at_most else '≥'} {100 * line.bound:g} %" if line in bound else "",
                f"{100 * line.rate:.1f} %",
                f"{100 * line.sigma:.1f}",
                line.n,
                line.verdict,
            )
            for line in lines
        ],
    )
    if designs := found.designs():
        effects = sorted({e for _, g in found.of("hidden", "single") for e in g.facts.effects})
        _show_power("Power by design", {design: found.power([design]) for design in designs})
        _show_power("Power by effect, all designs", {effect: found.power(designs, effect) for effect in effects})
    added = found.to_json()["added"]
    if added:
        frame.show_table(
            ("added", "s", "held-out RMS / noise: before", "after", "no fault", "miss / no fault", "/ same model"),
            [
                (
                    effect,
                    f"{a['s']:.1f}",
                    f"{a['held_out_before']:.2f}",
                    f"{a['held_out']:.3f}",
                    f"{a['floor']:.3f}",
                    f"{a['landed']:.2f}",
                    f"{a['landed_alike']:.2f}",
                )
                for effect, a in added.items()
            ],
            title="Effects added, and the robot compensated with them",
        )
    against = [
        (o.name, key, o.about, o.said.words)
        for row in known.names()
        for key, asked in known.get(row).bounds.items()
        if asked.bound == asked.bound
        for o in [o for o in found.outcomes if o.task.row == row and o.said.hits.get(key) is asked.at_most][:SHOWN]
    ]
    if against:
        header = ("data set (--replay)", "against", "what is in it", "what was said")
        frame.show_table(header, against, title="Data sets that speak against a bound")
    print(f"one data set takes {np.median([o.seconds for o in found.outcomes]):.2f} s (median) to judge")


def _show_power(title: str, curves: Mapping[str, Sequence[tuple[float, float, float, int]]]) -> None:
    sizes = sorted({s for curve in curves.values() for s, *_ in curve if s})
    rows = []
    for name, curve in curves.items():
        cells = {s: f"{100 * named:.0f} ({n})" for s, _, named, n in curve}
        rows.append((name, *(cells.get(s, "") for s in sizes)))
    frame.show_table(("truth named, % (of)", *(f"s = {s:g}" for s in sizes)), rows, title=title)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return frame.script("diagnosis_benchmark", command, argv)


if __name__ == "__main__":
    sys.exit(main())
