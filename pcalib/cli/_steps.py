"""What 'add' and 'drop' share: showing a step and keeping it in the model file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pcalib.cli.frame import say, show_table
from pcalib.diagnosis.steps import Step
from pcalib.model import Model


def finish(step: Step, model: Model, data: Path, output: Path) -> None:
    """Write the model with the step in its history, and print what the step changed.

    Raises:
        FitError: the refit cannot be trusted; nothing is written.
    """
    from pcalib import modelfile, summary
    from pcalib.diagnosis import telling

    fitted = step.after.model  # refuses with the reason
    figures = summary.statistics(step.after)
    entry = modelfile.snapshot(fitted, step.action, effect=step.spec, data=data.name, **figures)
    modelfile.save(output, replace(fitted, history=(*model.history, entry)), figures)
    say(telling.step_sentence(step))
    print()
    show_table(telling.BEFORE_AFTER, telling.before_after(step.before, step.after))
    for line in telling.step_lines(step):
        say(f"- {line}")
    moved = step.moved()
    if moved:
        show_table(
            ("moved", "by", "in its former σ"),
            [(name, telling.change(step, name, value), f"{times:.1f}") for name, value, times in moved[:8]],
            title="Geometry that had been bent to make up for it" if step.action == "add" else "Geometry that moved",
        )
    say(f"Model written to {output}.")
