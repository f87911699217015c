"""The command of scripts/diagnosis_benchmark: run, tables, figures, JSON."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from bench import pool
from bench.jobs.diagnosis_benchmark import cells as asked
from bench.jobs.diagnosis_benchmark import figures, trial
from bench.jobs.diagnosis_benchmark.cells import Cell
from bench.jobs.diagnosis_benchmark.results import Results
from bench.jobs.diagnosis_benchmark.trial import Trial
from pcalib import robot as robots
from pcalib.cli import frame
from pcalib.errors import InputError

ROOT = Path(__file__).resolve().parents[3]
WORKERS = 2


def command(
    *, seed: int = 0, out: Path = Path("out/diagnosis_benchmark"), json: frame.JsonOption = None,
    robot: Path | None = None, workers: int = WORKERS, part: tuple[str, ...] = (), quick: bool = False,
) -> int:  # fmt: skip
    """Hide effects in MuJoCo's robots, diagnose the data, and compare the rates with the bounds.

    Nothing, one effect, two, and effects of no library, at visible sizes from 3 to 20 noise units; rich and plain
    plans, full poses and positions only, noise stated right and wrong. Then effects are added, and the compensated
    robots land in MuJoCo with their faults still in them. Exit code 1 where a bound is missed by more than chance.

    Args:
        seed: The same seed gives the same data.
        out: Folder for the figures.
        robot: Robot file; the default Delta where absent.
        workers: Processes.
        part: Only these parts: none, single, pair, outside, add.
        quick: A few data sets, to see that everything runs.
    """
    if workers < 1 or seed < 0:
        raise InputError(f"--workers {workers} --seed {seed}: use positive numbers")
    tried = robots.load(robot or ROOT / "models" / "delta.toml")
    todo = [cell for cell in asked.cells(tried, quick) if not part or cell.part in part]
    if not todo:
        raise InputError(f"--part {' '.join(part)}: no such part", remedy="accepted: none, single, pair, outside, add")
    begun, found = time.monotonic(), []
    with frame.progress("diagnoses", sum(cell.trials for cell in todo)) as advance:
        for cell, trials in zip(todo, pool.ordered(partial(_one, tried.text, seed), todo, workers), strict=True):
            found += trials
            advance(cell.trials)
    results = Results(tuple(found), seed, time.monotonic() - begun)
    show(results)
    if not part and not quick:
        for path in figures.save(results, out):
            print(path)
    frame.write_json(json, results.to_json())
    broken = [line for line in results.lines if line.verdict == "falls short"]
    return frame.NOT_HELD if broken and not quick else frame.OK


def _one(text: str, seed: int, cell: Cell) -> list[Trial]:
    return trial.run(robots.parse(text, "robot"), seed, cell)


def show(found: Results) -> None:
    """Print the tables."""
    lines = [line for line in found.lines if line.n]
    held = sum(line.holds for line in lines)
    frame.say(
        f"{len(found.trials)} diagnoses in {found.seconds / 60:.1f} minutes; {held} of {len(lines)} bounds hold"
        + "".join(f"; {line.verdict}: {line.name}" for line in lines if not line.holds)
        + "."
    )
    frame.show_table(
        ("", "bound", "figure", "of", "verdict"),
        [
            (
                line.what,
                f"{'≤' if line.at_most else '≥'} {100 * line.bound:g} %",
                f"{100 * line.rate:.1f} %",
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
