"""The evidence for and against one effect.

pcalib explain drive_compliance data.csv --model m.toml
pcalib explain worm_gear.py:WormGear data.csv --model m.toml --plot evidence.svg
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli._inputs import EffectFiles, EffectSpec, ModelOption
from pcalib.cli._next import say_next
from pcalib.cli.frame import BesideOption, JsonOption, say, show_table, write_json


def command(
    effect: EffectSpec,
    data: Path,
    /,
    *,
    model: ModelOption,
    plot: BesideOption = None,
    report: BesideOption = None,
    effect_file: EffectFiles = (),
    json: JsonOption = None,
) -> int | None:
    """The evidence for and against one effect.

    How much of it these poses can show, its fitted size against its physical range, what would still be missing with
    it, which rivals do as well, and what happens to the held-out rows after a full refit.

    Args:
        effect: NAME, NAME:arm, a geometry level, or file.py:Class of your own.
        data: Measurement file, CSV or Parquet.
        plot: Also draw it, SVG.
        report: Also write a report, one self-contained HTML file.
    """
    from pcalib.cli._inputs import allowing, read
    from pcalib.diagnosis import results, telling
    from pcalib.diagnosis.evidence import evidence

    effect_file = allowing(effect, effect_file)
    calibrated, measured, own = read(model, data, effect_file)
    found = evidence(calibrated, measured, effect, own)
    write_json(json, results.evidence_json(found))
    if plot is not None:  # before anything is printed: a closed pipe loses no file
        from pcalib.diagnosis import figures

        figures.save(plot, figures.evidence(found))
    if report is not None:
        from pcalib.diagnosis import page

        page.write_evidence(report, calibrated, measured, found)
    say(telling.evidence_sentence(found))
    print()
    for line in telling.evidence_lines(found):
        say(f"- {line}")
    if found.before is not None and found.after is not None:
        print()
        show_table(telling.BEFORE_AFTER, telling.before_after(found.before, found.after))
    if plot is not None:
        say(f"Drawn to {plot}.")
    if report is not None:
        say(f"Report written to {report}.")
    if found.finding.adequate:
        say_next("add", effect, data, "--model", model, why="to refit with it")
    else:
        say_next("diagnose", data, "--model", model, why="to find what else may be missing")
    return None
