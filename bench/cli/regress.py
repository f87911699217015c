"""Compare a campaign's accuracy and speed with a committed baseline; for CI.

    pcbench regress bench/specs/regression.toml --baseline bench/specs/regression.baseline.json
    pcbench regress spec.toml --baseline base.json --junit regress.xml --markdown summary.md
    pcbench regress spec.toml --baseline base.json --update --reason "exact inverse now knows the hose"
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pcalib.cli.frame import BesideOption, JsonOption, WorkersOption


def command(
    spec: Path,
    /,
    *,
    baseline: Path,
    update: bool = False,
    reason: str = "",
    speed: Annotated[bool, Parameter(negative="--no-speed")] = True,
    workers: WorkersOption = 1,
    junit: BesideOption = None,
    markdown: BesideOption = None,
    json: JsonOption = None,
) -> int:
    """Compare a campaign's accuracy and speed with a committed baseline; for CI.

    Accuracy figures are seeded and repeat to rounding; tolerances stand in the spec under [regress]. Speed is compared
    as a ratio to a reference task of the same run. Exit code 1: something got worse.

    Args:
        spec: Campaign file (TOML), a small one.
        baseline: Baseline file (JSON).
        update: Write the baseline anew instead of failing.
        reason: Why the figures may change; kept in the baseline's history.
        speed: Whether to compare speed; --no-speed leaves it out, and the times of a baseline as they are.
        workers: Processes for the accuracy figures.
        junit: Write JUnit XML to this file.
        markdown: Write a Markdown summary to this file; for $GITHUB_STEP_SUMMARY.
    """
    from bench.jobs.campaign import regress, regress_report
    from bench.jobs.campaign import spec as specs
    from pcalib import files
    from pcalib.cli import frame
    from pcalib.errors import InputError

    if update and not reason.strip():
        raise InputError("--update needs a reason", remedy='--reason "why the figures may change"')
    if reason and not update:
        raise InputError("--reason goes with --update")
    if update:
        files.check_places(baseline)
        files.may_rewrite([baseline])
    campaign = specs.load(spec)
    before = regress.load(baseline, campaign) if not update else regress.earlier(baseline)
    with frame.progress(campaign.name, campaign.n_trials, "robots") as advance:
        found = {f.name: f for f in regress.measure(campaign, workers, speed, advance)}
    if not speed:
        before = {name: figure for name, figure in before.items() if figure.kind != "time"}
    changes = regress.compare(before, found, campaign)
    rows = regress_report.table(changes)
    if rows and before:
        frame.show_table(regress_report.HEADER, rows, title=f"{campaign.name}: what moved")
    frame.say(f"{campaign.name}: {regress_report.headline(changes)}")
    if junit is not None:
        files.write_text(junit, regress_report.junit(campaign.name, changes))
    if markdown is not None:
        files.write_text(markdown, regress_report.markdown(campaign.name, changes))
    frame.write_json(json, regress_report.as_json(campaign.name, changes))
    if update:
        kept = {} if speed else regress.times(baseline, campaign)
        regress.save(baseline, campaign, found | kept, changes, reason)
        frame.say(f"baseline written to {baseline}")
        return frame.OK
    return frame.NOT_HELD if any(change.regression for change in changes) else frame.OK
