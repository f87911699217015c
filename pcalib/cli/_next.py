"""The next command, complete and ready to paste: what every command ends with."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pcalib.cli.frame import say

if TYPE_CHECKING:
    from pcalib.fitting.result import Fit


MEASURED = "with what was measured written beside these rows"
"""What the command after a plan needs."""


def say_next(*words: str | Path, why: str = "") -> None:
    """Print a command of this program with its arguments quoted as a shell needs them; it is never wrapped.

    Args:
        why: what it does, or what it needs.
    """
    said = shlex.join(["pcalib", *map(str, words)])
    if why:
        say(f"Next, {why}:")
    print(f"Next: {said}" if not why else f"  {said}")


def after_fit(found: Fit, data: Path, robot: Path, model: Path | None, chosen: Sequence[str] = ()) -> None:
    """What to do with a fit: keep it, find what it misses, or use it.

    Args:
        chosen: options of the fit that its model depends on.
    """
    if model is None:
        say_next("fit", data, "--robot", robot, *chosen, "-o", "model.toml", why="to keep the model")
    else:
        after_model(found, data, model)


def after_model(found: Fit, data: Path, model: Path) -> None:
    """What to do with a fitted model: find what it misses, or use it."""
    noise = found.accuracy.at_the_noise and not (found.data.sigma_stated and found.accuracy.more_than_chance)
    if noise or found.accuracy.chi2_dof != found.accuracy.chi2_dof:
        to_compensate(model)
    else:
        say_next("diagnose", data, "--model", model, why="to find what the model misses")


def to_compensate(model: Path) -> None:
    """How to use a model that explains its data."""
    why = "with a file of targets (x_mm,y_mm,z_mm)"
    say_next("compensate", "targets.csv", "--model", model, "-o", "commands.csv", why=why)
