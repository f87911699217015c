"""Measure, calibrate and check many virtual robots, and see what accuracy to expect.

    pcbench campaign bench/specs/quick.toml -o out/quick
    pcbench campaign bench/specs/paper-at-scale.toml -o out/paper --workers 2
    pcbench campaign spec.toml -o out/run --scheduler tcp://10.0.0.5:8786
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pcalib.cli.frame import JsonOption, OutputFolder, WorkersOption


def command(
    spec: Path,
    /,
    *,
    output: OutputFolder,
    workers: WorkersOption | None = None,
    scheduler: str | None = None,
    figures: Annotated[bool, Parameter(negative="--no-figures")] = True,
    yes: bool = False,
    json: JsonOption = None,
) -> int:
    """Measure, calibrate and check many virtual robots, and see what accuracy to expect.

    The spec (docs/scale.md) says how robots differ from the drawing, how they are measured, calibrated and checked, and
    what is varied. Killed at any moment, the same command goes on where it stood, and ends with the same bytes.

    Args:
        spec: Campaign file (TOML).
        output: Folder for results.parquet, summary.csv, plots and recordings; for this campaign alone.
        workers: Processes on this machine; one per core when absent. Results do not depend on it.
        scheduler: Address of a dask scheduler, whose workers are used instead.
        figures: Whether to draw plots and recordings; --no-figures leaves them out.
        yes: Begin a campaign of more than 20,000 robots without asking.
    """
    from bench.jobs import running
    from bench.jobs.campaign import size, summary
    from bench.jobs.campaign import spec as specs
    from bench.jobs.campaign.study import Campaign
    from pcalib.cli import frame

    campaign = specs.load(spec)
    if not yes and not (output / "campaign.json").exists():
        size.require_agreement(campaign, workers, scheduler)
    try:
        with frame.progress(campaign.name, campaign.n_trials, "robots") as advance:
            outcome = running.run(Campaign(campaign), output, workers, scheduler, advance, frame.say)
    except running.Interrupted as interrupt:
        frame.say(f"{interrupt.kept} of {campaign.n_trials} robots are kept; the same command goes on from there")
        raise
    if outcome.trials:
        where = running.describe(outcome.workers, scheduler)
        frame.say(f"{outcome.trials} robots in {outcome.seconds:.1f} s on {where}: {outcome.rate:.1f} robots/s")
    else:
        frame.say("all robots were done before")
    found = summary.read(outcome.results)
    header, rows = summary.table(found)
    frame.show_table(header, rows, title=campaign.name)
    for reason, count in list(found.reasons.items())[:5]:
        frame.say(f"- {count} rows failed: {reason}")
    written = [outcome.results, summary.write_csv(found, output / "summary.csv")]
    if figures:
        from bench.jobs.campaign import plots, recording

        written += plots.write(found, output / "plots")
        written += recording.write(found, outcome.results, output)
    frame.say("written: " + ", ".join(str(path) for path in written))
    frame.write_json(json, {**summary.as_json(found), "rate": outcome.rate, "seconds": outcome.seconds})
    return frame.OK if any(len(group.rms) for group in found.groups) else frame.NOT_HELD
