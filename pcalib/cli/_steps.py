"""What 'add' and 'drop' share: showing a step and keeping it in the model file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcalib.cli._next import after_model
from pcalib.cli.frame import say, show_table
from pcalib.diagnosis.steps import Step
from pcalib.model import Model

if TYPE_CHECKING:
    from pcalib.data.measurement import Measurements


def finish(
    step: Step,
    model: Model,
    data: Path,
    output: Path,
    report: Path | None = None,
    measured: Measurements | None = None,
    effect_files: tuple[str, ...] = (),
    rivals: Callable[[Model], Model] = lambda fitted: fitted,
) -> dict[str, Any] | None:
    """Write the model with the step in its history, and print what the step changed.

    Args:
        report: HTML file to write too, of the fit after the step to the `measured` rows.
        rivals: adds to the fitted model the rival explanations that fit as well as the step.

    Returns:
        What to expect of landings, as JSON.

    Raises:
        FitError: the refit cannot be trusted; nothing is written.
    """
    from pcalib import modelfile, summary
    from pcalib.diagnosis import telling
    from pcalib.uncertainty import assessed, outlook
    from pcalib.uncertainty import rivals as known

    fitted = rivals(assessed(step.after))  # refuses with the reason
    expected, content = outlook.said(fitted, known.models(fitted, effect_files))
    figures = summary.statistics(step.after)
    entry = modelfile.snapshot(fitted, step.action, effect=step.spec, data=data.name, **figures)
    modelfile.save(output, replace(fitted, history=(*model.history, entry)), figures)
    if report is not None and measured is not None:
        from pcalib.report import calibration
        from pcalib.uncertainty import maps

        over = maps.of_model(fitted, effect_files)
        calibration.write_fit(report, step.after, measured, [telling.step_sentence(step), expected], over)
    say(telling.step_sentence(step))
    print()
    show_table(telling.BEFORE_AFTER, telling.before_after(step.before, step.after))
    for line in telling.step_lines(step):
        say(f"- {line}")
    say(f"- {expected}")
    if others := known.words(fitted):
        say(f"- These data allow as well: {others}. Where these put the TCP elsewhere, the figures above count it.")
    moved = step.moved()
    if moved:
        show_table(
            ("moved", "by", "in its former σ"),
            [(name, telling.change(step, name, value), f"{times:.1f}") for name, value, times in moved[:8]],
            title="Geometry that had been bent to make up for it" if step.action == "add" else "Geometry that moved",
        )
    say(f"Model written to {output}.")
    if report is not None:
        say(f"Report written to {report}.")
    after_model(step.after, data, output)
    return content
