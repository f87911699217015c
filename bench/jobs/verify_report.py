"""What a verification says: checks, table and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.jobs.verify import Verification
from pcalib.cli import frame
from pcalib.wording import size


@dataclass(frozen=True)
class Check:
    """A limit that was asked for."""

    name: str
    limit: float
    found: float

    @property
    def held(self) -> bool:
        """Whether the limit holds; a figure that is not a number holds nothing."""
        return self.found <= self.limit


def checks(done: Mapping[str, Verification], limits: Mapping[str, float | None]) -> list[Check]:
    """The limits that are given, 'rms', 'max', 'ap', 'rp' [µm], over all tools; and that every command landed."""
    figures = [v.accuracy for v in done.values()]
    found = {
        "rms": max(a.rms for a in figures),
        "max": max(a.max for a in figures),
        "ap": max(float(np.nanmax(a.ap)) for a in figures),
        "rp": max(float(np.nanmax(a.rp)) for a in figures),
    }
    asked = [Check(name, limit, found[name] * 1e6) for name, limit in limits.items() if limit is not None]
    return asked + ([Check("commands not landed", 0, sum(v.not_landed for v in done.values()))] if asked else [])


def content(done: Mapping[str, Verification], asked: list[Check]) -> dict[str, Any]:
    """The outcome as JSON, `pcbench.verify/1`; one entry per tool."""
    return {
        "schema": "pcbench.verify/1",
        "held": all(check.held for check in asked),
        "checks": [{"name": c.name, "limit": c.limit, "found": c.found, "held": c.held} for c in asked],
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
            words, counts = np.unique(v.status[v.status != "ok"], return_counts=True)
            why = ", ".join(f"{count}× {word}" for word, count in zip(words, counts, strict=True))
            frame.say(f"- {label}: {v.failed} of {len(v.task.position)} targets not reached in every cycle ({why}).")
    for check in asked:
        verdict = "holds" if check.held else "DOES NOT HOLD"
        frame.say(f"- {check.name} ≤ {check.limit:g}: {verdict}, found {check.found:.4g}")
