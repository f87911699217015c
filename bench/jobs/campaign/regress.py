"""Keeping accuracy from getting worse: a campaign's figures against those of a committed baseline.

All random numbers are seeded: figures repeat to rounding, so that a change has a cause in the code. Times are compared
as ratios to a reference task that runs in between, so that a slower or busier machine is no regression.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.jobs import running, store, study
from bench.jobs.campaign import summary, trial
from bench.jobs.campaign.spec import Spec
from bench.jobs.campaign.study import Campaign
from bench.jobs.campaign.summary import RobotGroup
from bench.jobs.campaign.sweep import short
from pcalib import files
from pcalib.errors import InputError

SCHEMA = "pcbench.baseline/1"
REPEATS = 7
"""Repetitions of every timing. The fastest counts, because other programs can only make it slower."""
SHORT = 0.1
"""Smallest difference of two times that counts, as a share of the time of the reference task."""


@dataclass(frozen=True)
class CampaignFigure:
    """One number of a campaign."""

    name: str
    """What it is, e.g. 'complete, tool 300 mm: RMS'."""
    kind: str
    """'error' [m], 'failed' robots, 'reached' share of the targets, 'time' in units of the reference task."""
    value: float


@dataclass(frozen=True)
class FigureChange:
    """A figure, then and now."""

    name: str
    kind: str
    before: float | None
    """None where the baseline does not have it."""
    now: float | None
    """None where it is gone."""
    verdict: str
    """'same', 'better', 'worse', 'new' or 'gone'."""

    @property
    def regression(self) -> bool:
        """Whether the comparison fails because of this change."""
        return self.verdict in ("worse", "gone")

    @property
    def moved(self) -> str:
        """The change in words."""
        if self.before is None or self.now is None:
            return self.verdict
        if self.kind in ("failed", "reached") or not self.before:
            return f"{self.now - self.before:+.3g}"
        ratio = self.now / self.before
        return f"× {ratio:.3g}" if ratio >= 3 else f"{100 * (ratio - 1):+.1f} %"


def measure(
    spec: Spec, workers: int = 1, speed: bool = True, progress: Callable[[int], None] = lambda done: None
) -> list[CampaignFigure]:
    """The figures of a campaign, whose results are kept nowhere."""
    found = summary.of([running.table(Campaign(spec), workers, progress)], Campaign(spec).schema())
    out: list[CampaignFigure] = []
    for group in found.groups:
        name = _name(group, found.spec.paths)
        out += [
            CampaignFigure(f"{name}: RMS", "error", group.pooled),
            CampaignFigure(f"{name}: RMS, 95 % of the robots below", "error", group.percentile(95)),
            CampaignFigure(f"{name}: maximum", "error", group.worst),
            CampaignFigure(f"{name}: failed robots", "failed", float(group.failed)),
            CampaignFigure(f"{name}: targets reached", "reached", group.reached),
        ]
    out += timings(spec) if speed else []
    names = [figure.name for figure in out]
    assert len(set(names)) == len(names), "figures of one name would hide each other"
    return out


def timings(campaign: Spec) -> list[CampaignFigure]:
    """What the steps of the first robot cost, in units of a reference task."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        steps = trial.steps(campaign, 0)
        best = dict.fromkeys([*steps, ""], math.inf)
        for _ in range(REPEATS):
            for name, step in [*steps.items(), ("", reference)]:
                begun = time.perf_counter()
                step()
                best[name] = min(best[name], time.perf_counter() - begun)
    return [CampaignFigure(f"{name}: time", "time", best[name] / best[""]) for name in steps]


def reference() -> None:
    """A fixed task of the same nature as a trial: small arrays, many of them, and LAPACK."""
    rng = np.random.default_rng(0)
    a = rng.standard_normal((600, 6, 6)) + 4 * np.eye(6)
    J = rng.standard_normal((240, 60))
    for _ in range(6):
        x = np.linalg.solve(a, a[..., :1])[..., 0]
        for _ in range(40):
            x = np.sin(x) * x[..., ::-1] + np.sqrt(np.abs(x))
        np.linalg.svd(J)


def compare(
    before: Mapping[str, CampaignFigure], now: Mapping[str, CampaignFigure], campaign: Spec
) -> list[FigureChange]:
    """Every figure of either side, with a verdict by the tolerances of the spec's [regress]."""
    out = []
    for name in [*before, *(name for name in now if name not in before)]:
        old, new = before.get(name), now.get(name)
        kind = (new or old).kind  # type: ignore[union-attr]
        if old is None or new is None:
            verdict = "new" if old is None else "gone"
        else:
            verdict = _verdict(kind, old.value, new.value, campaign)
        out.append(FigureChange(name, kind, old and old.value, new and new.value, verdict))
    return out


def _verdict(kind: str, before: float, now: float, campaign: Spec) -> str:
    tolerance = campaign.regress
    if math.isnan(before) or math.isnan(now):
        return "same" if math.isnan(before) and math.isnan(now) else "worse" if math.isnan(now) else "better"
    if kind == "time":
        slow, quick = (max(a * tolerance.speed, a + SHORT) for a in (before, now))
        return "worse" if now > slow else "better" if before > quick else "same"
    slack = tolerance.accuracy * before + tolerance.floor if kind == "error" else 1e-9
    growth = before - now if kind == "reached" else now - before
    return "worse" if growth > slack else "better" if growth < -slack else "same"


def _name(group: RobotGroup, paths: Sequence[str]) -> str:
    point = [f"{path} = {short(group.point[path])}" for path in paths]
    return ", ".join([*point, group.method, f"tool {summary.tool_text(group)} mm"])


# -- the baseline file -------------------------------------------------------------------------------------------------


def load(path: Path, campaign: Spec) -> dict[str, CampaignFigure]:
    """The figures of a baseline.

    Raises:
        InputError: no such file, no baseline, or that of another spec.
    """
    if not path.exists():
        raise InputError("no such baseline", file=path, remedy='make one with --update --reason "first baseline"')
    content = _content(path)
    if changed := _changed(content, campaign):
        raise InputError(
            f"the baseline belongs to another spec: {'; '.join(changed[:4])}", file=path,
            remedy='make it anew with --update --reason "what changed and why"',
        )  # fmt: skip
    return _figures(content)


def earlier(path: Path) -> dict[str, CampaignFigure]:
    """The figures of whatever baseline was there before; none where there was none."""
    return _figures(_content(path)) if path.exists() else {}


def times(path: Path, campaign: Spec) -> dict[str, CampaignFigure]:
    """The times of a baseline that belongs to this spec, to be kept where none are taken; none of another spec."""
    if not path.exists() or _changed(_content(path), campaign):
        return {}
    return {name: figure for name, figure in earlier(path).items() if figure.kind == "time"}


def _figures(content: Mapping[str, Any]) -> dict[str, CampaignFigure]:
    return {
        name: CampaignFigure(name, figure["kind"], math.nan if figure["value"] is None else figure["value"])
        for name, figure in content["figures"].items()
    }


def save(
    path: Path, campaign: Spec, figures: Mapping[str, CampaignFigure], changes: list[FigureChange], reason: str
) -> None:
    """Write the baseline anew, with the reason and what moved added to its history.

    Raises:
        InputError: no reason, or the file cannot be written.
    """
    if not reason.strip():
        raise InputError("--update needs a reason", remedy='--reason "why the figures may change"')
    history = _content(path)["history"] if path.exists() else []
    moved = {c.name: {"before": _finite(c.before), "now": _finite(c.now)} for c in changes if c.verdict != "same"}
    content = {
        "schema": SCHEMA,
        "campaign": campaign.name,
        "history": [*history, {"reason": reason.strip(), "moved": moved}],
        "versions": {name: v for name, v in study.versions().items() if name != "code"},
        "figures": {name: {"kind": f.kind, "value": _finite(f.value)} for name, f in figures.items()},
        "spec": json.loads(campaign.source),
    }
    files.write_text(path, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def _content(path: Path) -> dict[str, Any]:
    remedy = "name the file that --update wrote"
    content = files.parse_json(files.read_text(path), path, remedy)
    if content.get("schema") != SCHEMA:
        raise InputError("is no baseline of pcbench regress", file=path, remedy=remedy)
    figure = {"kind": str, "value": (float, None)}
    files.require_shape(content, {"figures": {"*": figure}, "history": [{}], "spec": {}}, path, remedy)
    return content


def _changed(content: Mapping[str, Any], campaign: Spec) -> list[str]:
    """Where the spec of a baseline and this one differ."""
    return list(store.differences(_relevant(content["spec"]), _relevant(json.loads(campaign.source))))


def _relevant(spec: dict[str, Any]) -> dict[str, Any]:
    """The spec without the keys that only say how results are compared."""
    return {key: value for key, value in spec.items() if key != "regress"}


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(f"{value:.9g}")
