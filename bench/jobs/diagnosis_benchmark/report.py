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
from bench.jobs.diagnosis_benchmark import cells as asked
from bench.jobs.diagnosis_benchmark import figures, trial
from bench.jobs.diagnosis_benchmark import rows as made_by
from bench.jobs.diagnosis_benchmark.cells import Cell
from bench.jobs.diagnosis_benchmark.results import Results
from bench.jobs.diagnosis_benchmark.rows import Outcome
from bench.jobs.diagnosis_benchmark.trial import Trial
from bench.jobs.hidden.grading import Line
from pcalib import files, modelfile
from pcalib import robot as robots
from pcalib.cli import frame
from pcalib.data import measurement
from pcalib.errors import InputError, unknown

ROOT = Path(__file__).resolve().parents[3]
WORKERS = 2
SHOWN = 4
"""Data sets that are named for each bound they speak against."""


PARTS = ("none", "single", "pair", "outside", "add")
"""Rows of hidden faults; the others are files of `rows`."""


def command(
    *, seed: int = 0, out: Path = Path("out/diagnosis_benchmark"), json: frame.JsonOption = None,
    robot: Path | None = None, workers: int = WORKERS,
    rows: Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative=())] = (),
    n: Annotated[int | None, Parameter(name="-n")] = None, replay: str | None = None, quick: bool = False,
) -> int:  # fmt: skip
    """Hide effects in MuJoCo's robots, diagnose the data, and compare the rates with the bounds.

    Nothing, one effect, two, and effects of no library, at visible sizes from 3 to 20 noise units; rich and plain
    plans, full poses and positions only, noise stated right and wrong. Then effects are added, and the compensated
    robots land in MuJoCo with their faults still in them. Further rows: noise as instruments make it, steps, held-out
    rows that must be heard, agreement of the commands, coverage of intervals. Exit code 1 where a bound is missed by
    more than chance.

    Args:
        seed: The same seed gives the same data.
        out: Folder for the figures, and for the data set of --replay.
        robot: Robot file for hidden faults; the default Delta where absent.
        workers: Processes.
        rows: Only these rows: none, single, pair, outside, add, noise, steps, held_out, agreement, coverage …; or one
            variant of a row, such as noise.correlated.
        n: Only so many data sets of each variant of a row.
        replay: Write one data set by its name, such as noise.white/7#2, with its model and robot, and diagnose nothing.
        quick: A few data sets, to see that everything runs.
    """
    if workers < 1 or seed < 0 or (n is not None and n < 1):
        raise InputError(f"--workers {workers} --seed {seed} -n {n}: use positive numbers")
    if replay is not None:
        return _replayed(replay, seed, out)
    tried = robots.load(robot or ROOT / "models" / "delta.toml")
    cells = [cell for cell in asked.cells(tried, quick) if not rows or cell.part in rows]
    for name in rows:
        if name not in PARTS and name.partition(".")[0] not in made_by.names():
            raise InputError(f"--rows: {unknown('row', name, [*PARTS, *made_by.names()])}")
    tasks = made_by.tasks([r for r in rows if r not in PARTS] if rows else made_by.names(), 1 if quick else n)
    begun = time.monotonic()
    found: list[Trial] = []
    outcomes: list[Outcome] = []
    with frame.progress("diagnoses", sum(c.trials for c in cells) + sum(t.sets for t in tasks)) as advance:
        for cell, trials in zip(cells, pool.ordered(partial(_one, tried.text, seed), cells, workers), strict=True):
            found += trials
            advance(cell.trials)
        for task, judged in zip(tasks, pool.ordered(partial(made_by.run, seed=seed), tasks, workers), strict=True):
            outcomes += judged
            advance(task.sets)
    results = Results(tuple(found), seed, time.monotonic() - begun)
    lines = [*results.lines, *made_by.lines(outcomes)]
    show(results, lines, len(outcomes))
    _show_outcomes(outcomes)
    if not rows and not quick:
        for path in figures.save(results, out):
            print(path)
    content = results.to_json()
    content["bounds"] = [line.to_json() for line in lines]
    frame.write_json(json, content | {"sets": [outcome.to_json() for outcome in outcomes]})
    broken = [line for line in lines if line.verdict == "falls short"]
    return frame.NOT_HELD if broken and not quick else frame.OK


def _one(text: str, seed: int, cell: Cell) -> list[Trial]:
    return trial.run(robots.parse(text, "robot"), seed, cell)


def _replayed(name: str, seed: int, out: Path) -> int:
    made = made_by.replay(name, seed)
    out.mkdir(parents=True, exist_ok=True)
    measurement.save(out / "data.csv", made.data)
    modelfile.save(out / "model.toml", made.model)
    files.write_text(out / "robot.toml", made.model.robot.text)
    frame.say(f"{out}: data.csv, model.toml and robot.toml of {name} ({made.about})")
    return frame.OK


def _show_outcomes(outcomes: Sequence[Outcome]) -> None:
    """Print the sets that speak against a bound, the first of each line."""
    rows = []
    for line in made_by.lines(outcomes):
        if not line.n:
            continue
        key = line.name.rpartition(".")[2]
        mine = [o for o in outcomes if line.name.startswith(o.name.partition("/")[0] + ".")]
        against = [o for o in mine if o.hits.get(key) is line.at_most]
        rows += [(o.name, key, o.about, o.said) for o in against[:SHOWN]]
    if rows:
        frame.show_table(("data set (--replay)", "against", "what is in it", "what was said"), rows)


def show(found: Results, lines: Sequence[Line], sets: int = 0) -> None:
    """Print the tables."""
    lines = [line for line in lines if line.n]
    held = sum(line.holds for line in lines)
    frame.say(
        f"{len(found.trials) + sets} data sets in {found.seconds / 60:.1f} minutes; {held} of {len(lines)} bounds hold"
        + "".join(f"; {line.verdict}: {line.name}" for line in lines if not line.holds)
        + "."
    )
    frame.show_table(
        ("", "bound", "figure", "±σ", "of", "verdict"),
        [
            (
                line.what,
                "" if line.verdict == "for comparison" else f"{'≤' if line.at_most else '≥'} {100 * line.bound:g} %",
                f"{100 * line.rate:.1f} %",
                f"{100 * line.sigma:.1f}",
                line.n,
                line.verdict,
            )
            for line in lines
        ],
    )
    if found.of("single"):
        designs = list(dict.fromkeys(t.cell.design for t in found.of("single")))
        effects = sorted({e for t in found.of("single") for e in t.grade.facts.effects})
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
    wrong = found.mistakes()
    if wrong:
        frame.show_table(
            ("design", "hidden", "s", "established"),
            [
                (t.cell.design, " + ".join(t.grade.facts.faults) or "nothing", f"{t.grade.facts.size:.1f}",
                 ", ".join(t.grade.answer.established))
                for t in wrong
            ],
            title="Called established, and not there",
        )  # fmt: skip
    seconds = [t.seconds for t in found.trials if t.seconds]
    if seconds:
        print(f"one diagnosis takes {np.median(seconds):.2f} s (median), {np.max(seconds):.2f} s at most")


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
