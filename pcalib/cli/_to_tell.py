"""`pcalib plan --to-tell`: rows that tell effects apart, and how far they do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcalib.cli.frame import say, show_table, write_json
from pcalib.diagnosis.separation import TOLD, AtHand, Separation, plan
from pcalib.robot import Robot

SHOWN = 8
"""Pairs and effects that are listed one by one."""


def run(
    robot: Robot,
    n: int,
    sigma: np.ndarray,
    wanted: Sequence[str],
    at_hand: AtHand,
    level: str,
    seed: int,
    output: Path,
    plot: Path | None,
    json: Path | None,
) -> None:
    """Choose the rows, write the plan, and say what it can tell.

    Args:
        sigma: (6,) [m, rad] 1σ of the instrument; inf where a component is not measured.
        wanted: names of effects; all that the robot can have when empty.
    """
    from pcalib import planning
    from pcalib.data import table

    found = plan(robot, n, sigma, wanted, at_hand, level, seed)
    columns: dict[str, Any] = dict(planning.table(robot, found.q, found.conditions, found.position))
    columns["pose_id"] = [str(number) if number >= 0 else "" for number in found.pose_id]
    table.write(output, columns, {"robot": robot.name})
    write_json(json, as_json(found))
    if plot is not None:
        from pcalib.diagnosis import figures

        figures.save(plot, figures.separation(found))
    show(found, output)


def as_json(found: Separation) -> dict[str, Any]:
    """`pcalib.separation/1`."""
    return {
        "schema": "pcalib.separation/1",
        "effects": list(found.names),
        "separation": found.matrix,
        "aliases": [list(pair) for pair in found.aliases],
        "not_shown": found.hidden,
        "told_apart_from": TOLD,
        "rows": len(found.q),
    }


def show(found: Separation, output: Path) -> None:
    """Print what the rows can tell."""
    poor, faint = found.poorest, found.faint
    said = f"{len(found.q)} rows written to {output}."
    if not poor and not found.aliases:
        said += " They tell every visible effect from every other."
    else:
        count = len(poor) + len(found.aliases)
        said += f" {count} pairs of effects are not told apart." if count > 1 else " One pair of effects is not."
    say(said)
    print()
    rows = [(name, f"{found.matrix[i, i]:.1f}", *_hardest(found, i)) for i, name in enumerate(found.names)]
    show_table(("effect", "visible", "least left", "by a fit with"), rows, title="At usual size, in units of noise")
    for a, b in found.aliases[:SHOWN]:
        say(f"- {a} and {b} do the same to every row: no plan under these conditions tells them apart.")
    for a, b, least in poor[:SHOWN]:
        say(f"- {a} leaves {least:.1f} to a fit with {b}; {TOLD:.0f} are needed. More rows or larger loads would help.")
    if faint:
        said = ", ".join(f"{name} {size:.1f}" for name, size in faint[:SHOWN])
        say(f"- Too small to be seen at usual size with these rows: {said}.")
    for name, why in found.hidden.items():
        say(f"- {name}: {why}.")


def _hardest(found: Separation, i: int) -> tuple[str, str]:
    """Noise units of effect i that remain beside the effect most like it, and the name of that effect."""
    others = np.where(np.arange(len(found.names)) == i, np.inf, found.matrix[i])
    j = int(np.argmin(others))
    return ("alias" if found.alias[i, j] else f"{others[j]:.1f}"), found.names[j]
