"""`pcalib plan --within`: how many poses reach an accuracy with an instrument, or that no number does."""

from __future__ import annotations

from typing import Any

import numpy as np

from pcalib.cli.frame import say, show_table
from pcalib.robot import Robot
from pcalib.uncertainty.poses import MOST, Reach, reach
from pcalib.wording import angle, size


def run(
    robot: Robot, within: float, tools: np.ndarray, sigma: np.ndarray, level: str, seed: int
) -> tuple[int | None, dict[str, Any]]:
    """Print how many poses reach the accuracy with the longest tool; return their number, None if none does, and JSON.

    Args:
        within: [m] radius that is to contain 95 % of the landings.
        tools: (T, 3) [m], measured.
        sigma: (6,) [m, rad] 1σ of the instrument; inf where a component is not measured.
    """
    longest = tools[int(np.argmax(np.linalg.norm(tools, axis=1)))]
    found = reach(robot, within, longest, tools, sigma, level, seed)
    rows = [(n, size(u), size(r)) for n, u, r in zip(found.counts, found.u95, found.rms, strict=True)]
    show_table(("poses", "95 % of landings within", "RMS"), rows)
    for line in lines(found, sigma):
        say(line)
    return found.poses, to_json(found)


def lines(found: Reach, sigma: np.ndarray) -> list[str]:
    """The outcome in words."""
    note = "as far as geometry goes: what a fit leaves unexplained comes on top"
    if found.poses is not None:
        return [f"{found.poses} poses bring 95 % of landings within {size(found.within)}, {note}."]
    out = [
        f"No number of poses up to {MOST} brings 95 % of landings within {size(found.within)} with this instrument: "
        f"{size(found.limit)} are left, {note}."
    ]
    if found.with_rotations is not None:
        poses = found.with_rotations
        out.append(f"- An instrument that reads orientation as well, to 0.005°, would need {poses} poses.")
    if found.sigma is not None:
        more = f" and {angle(found.sigma[1])}" if np.isfinite(found.sigma[1]) else ""
        out.append(f"- An instrument with σ {size(found.sigma[0])}{more} would do.")
    if found.with_rotations is None and found.sigma is None:
        out.append("- No better instrument of this sort would do either: measure with more tools, or a simpler level.")
    return out


def to_json(found: Reach) -> dict[str, Any]:
    """What `pcalib.plan/1` says of it."""
    return {
        "within_um": found.within * 1e6,
        "poses_needed": found.poses,
        "limit_um": found.limit * 1e6,
        "by_poses": [
            {"poses": n, "u95_um": u * 1e6, "rms_um": r * 1e6}
            for n, u, r in zip(found.counts, found.u95, found.rms, strict=True)
        ],
        "sigma_needed_um": None if found.sigma is None else found.sigma[0] * 1e6,
        "poses_with_rotations": found.with_rotations,
    }
