"""The study as tables, and the command of scripts/reproduce_savoure2006."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import pyarrow.parquet as pq

from bench.jobs import running
from bench.jobs.methods import Method
from bench.jobs.savoure2006 import figures, study, trial
from pcalib import files
from pcalib.cli import frame
from pcalib.errors import InputError


def command(
    *, seeds: int = 200, out: Path = Path("out/savoure2006"),
    json: frame.JsonOption = None, robots: int = 20, workers: int | None = None, quick: bool = False,
) -> int:  # fmt: skip
    """Repeat the numerical study of Savoure et al. (ICRA 2006), and go on from there.

    Prints the planar ladder for tools of 0, 100 and 200 mm, what a calibration at 100 mm is worth with other tools, and
    the ladder of the Delta. Draws figures 5, 6 and 7 of the paper, and three more. See docs/paper.md.

    Args:
        seeds: Noise seeds of the tables; the studies of noise, poses and scale use a fifth of them.
        out: Folder for the figures, and for the results of every seed (results/results.parquet). A run that was
            interrupted goes on where it stood.
        robots: Random Deltas.
        workers: Processes; as many as there are processors where not given.
        quick: A few seeds, robots and values only, to see that everything runs.
    """
    if quick:
        seeds, robots = min(seeds, 10), min(robots, 2)
    for name, value in (("--seeds", seeds), ("--robots", robots), ("--workers", workers)):
        if value is not None and value < 1:
            raise InputError(f"{name} {value} must be at least 1")
    files.check_folder(out)
    files.check_places(json)
    asked = study.Savoure(seeds, robots, quick)
    with frame.progress("seeds and robots", asked.n_trials) as advance:
        outcome = running.run(asked, out / "results", workers, progress=advance, say=frame.say, renew=True)
    found = study.found(asked, pq.read_table(outcome.results))
    show(found)
    for path in figures.save(found, out):
        print(path)
    frame.write_json(json, study.summary(found))
    return frame.OK


Column = tuple[str, study.Scores, float]
"""Heading, scores, tool length in use."""


def show(found: study.Found) -> None:
    """Print the tables and what follows from them."""
    _table(
        f"Planar mechanism of Table 2, measured and used with one tool, mean of {found.seeds} seeds",
        trial.PLANAR_METHODS,
        [(f"h = {1e3 * h:.0f}", scores, h) for h, scores in found.ladder.items()],
    )
    _table(
        "The same, measured with h = 100 mm, used with others",
        trial.PLANAR_METHODS,
        [(f"h = {1e3 * h:.0f}", found.transfer, h) for h in trial.TOOLS],
    )
    for name, scores in found.delta.items():
        length, angle = trial.DELTA_ERRORS[name]
        _table(
            f"Delta, errors {1e3 * length:g} mm and {angle / trial.DEGREE:g}° (1σ), {trial.DELTA_POSES} poses measured "
            f"at the plate, {len(trial.delta_targets())} targets",
            trial.DELTA_METHODS,
            [(f"tool {1e3 * h:.0f}", scores, h) for h in trial.DELTA_TOOLS],
        )
    print(f"planar: {found.rank} of 9 errors can be identified")
    for h, scores in found.ladder.items():
        old, paper, ours = (scores[key, h].rms for key in ("classical", "paper_linear_first_order", "map_exact"))
        print(
            f"h = {1e3 * h:3.0f} mm: the paper's method is {old / paper:.0f} times better than the classical one; "
            f"MAP with the exact inverse another {paper / ours:.1f} times"
        )


def _table(title: str, methods: Sequence[Method], columns: Sequence[Column]) -> None:
    rows = [
        [m.label, *(f"{1e3 * s[m.name, h].rms:.4f} / {1e3 * s[m.name, h].max:.4f}" for _, s, h in columns)]
        for m in methods
    ]
    frame.show_table(["RMS / max [mm]", *(heading for heading, _, _ in columns)], rows, title=title)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return frame.script("reproduce_savoure2006", command, argv)


if __name__ == "__main__":
    sys.exit(main())
