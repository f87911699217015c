"""What a verification says: checks, table and JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.jobs.verify import Verification
from pcalib.cli import frame
from pcalib.wording import size


@dataclass(frozen=True)
class Check:
    """A limit that was asked for, of a length [m] or of a number of targets."""

    name: str
    limit: float
    found: float
    length: bool = True
    why: str = ""
    """The cause of the figure, where it is known."""

    @property
    def held(self) -> bool:
        """Whether the limit holds; a figure that is not a number holds nothing."""
        return self.found <= self.limit

    def as_json(self) -> dict[str, Any]:
        """Limit and figure, lengths in µm."""
        unit, factor = ("um", 1e6) if self.length else ("1", 1)
        figures = {"limit": self.limit * factor, "found": self.found * factor, "unit": unit}
        return {"name": self.name, **figures, "held": self.held}

    def sentence(self) -> str:
        """The outcome in one line."""
        limit, found = (_told(v) if self.length else f"{v:g}" for v in (self.limit, self.found))
        why = f" ({self.why})" if self.why else ""
        return f"{self.name} ≤ {limit}: {'holds' if self.held else 'DOES NOT HOLD'}, found {found}{why}"


def _told(metres: float) -> str:
    """A length with one digit more than in tables, so that it can be distinguished from its limit."""
    return f"{metres * 1e3:.4g} mm" if metres >= 1e-3 else f"{metres * 1e6:.4g} µm"


def checks(done: Mapping[str, Verification], limits: Mapping[str, float], max_failed: int | None = None) -> list[Check]:
    """The limits that are given, 'rms', 'max', 'ap', 'rp' [m], over all tools; and that enough targets were attained.

    Args:
        max_failed: targets that may fail; none where a limit is given and this is not.
    """
    figures = [v.accuracy for v in done.values()]
    found = {
        "rms": max(a.rms for a in figures),
        "max": max(a.max for a in figures),
        "ap": max(float(np.nanmax(a.ap)) for a in figures),
        "rp": max(float(np.nanmax(a.rp)) for a in figures),
    }
    asked = [Check(name, limit, found[name]) for name, limit in limits.items()]
    if not asked and max_failed is None:
        return []
    failed = sum(v.failed for v in done.values())
    why = sum((Counter(v.reasons) for v in done.values()), Counter())
    return [*asked, Check("targets not attained", max_failed or 0, failed, length=False, why=_counted(why))]


def _counted(reasons: Mapping[str, int]) -> str:
    return ", ".join(f"{count}× {word}" for word, count in reasons.items())


def content(done: Mapping[str, Verification], asked: list[Check]) -> dict[str, Any]:
    """The outcome as JSON, `pcbench.verify/1`; one entry per tool."""
    return {
        "schema": "pcbench.verify/1",
        "held": all(check.held for check in asked),
        "checks": [check.as_json() for check in asked],
        "tools": [
            {
                "tool": label,
                "targets": len(v.task.position),
                "failed": v.failed,
                "cycles": v.cycles,
                "rms_um": v.accuracy.rms * 1e6,
                "max_um": v.accuracy.max * 1e6,
                "ap_max_um": np.nanmax(v.accuracy.ap) * 1e6,
                "ap_mean_um": np.nanmean(v.accuracy.ap) * 1e6,
                "rp_max_um": np.nanmax(v.accuracy.rp) * 1e6,
                "rp_mean_um": np.nanmean(v.accuracy.rp) * 1e6,
            }
            for label, v in done.items()
        ],
    }


def show(model: str, done: Mapping[str, Verification], asked: list[Check]) -> None:
    """Print the outcome: one sentence, a table, what to know, the checks."""
    rms, worst = max(v.accuracy.rms for v in done.values()), max(v.accuracy.max for v in done.values())
    frame.say(f"By model {model} the TCP lands within {size(rms)} RMS of its targets, {size(worst)} at worst.")
    print()
    header = ("", "targets", "failed", "RMS", "max", "AP max", "AP mean", "RP max", "RP mean")
    rows = []
    for label, v in done.items():
        a = v.accuracy
        ap, rp = ([size(float(np.nanmax(x))), size(float(np.nanmean(x)))] for x in (a.ap, a.rp))
        rows.append((label, len(v.task.position), v.failed, size(a.rms), size(a.max), *ap, *rp))
    frame.show_table(header, rows)
    if all(v.alike for v in done.values()):
        frame.say("Nothing in this truth differs between cycles: one stands for all of them, and RP is zero.")
    for label, v in done.items():
        if v.failed:
            said = f"{v.failed} of {len(v.task.position)} targets not reached in every cycle ({_counted(v.reasons)})"
            frame.say(f"- {label}: {said}.")
    for check in asked:
        frame.say(f"- {check.sentence()}")
