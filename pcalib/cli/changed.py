"""What changed since the session of a model: nothing, a part, one of several, or something unexplained.

pcalib changed june.csv --model march.toml
pcalib changed june.csv --model march.toml --update -o june.toml
pcalib changed 2026-*.csv --model march.toml --chart history.html
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from pcalib.cli._inputs import EffectFiles, ModelOption
from pcalib.cli._next import say_next
from pcalib.cli.frame import BesideOption, JsonOption, OutputOption, SeedOption, say, show_table, write_json

if TYPE_CHECKING:
    from pcalib.changes.results import Changes
    from pcalib.model import Model


def command(
    data: Path,
    /,
    *more: Path,
    model: ModelOption,
    same_setup: Annotated[bool, Parameter(negative=())] = False,
    update: Annotated[bool, Parameter(negative=())] = False,
    output: OutputOption = None,
    chart: BesideOption = None,
    effect_file: EffectFiles = (),
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> int | None:
    """What changed since the session of a model: nothing, a part, one of several, or something unexplained.

    The new session is compared with what the model predicts, its own uncertainty and the noise allowed for. Twelve
    poses are enough to ask. The measuring frame may have moved, unless the set-up is said to be the same. Parts are
    motor zeros and mounts, arms, ball joints, rods and the plate; effects count too, and so does a slip between two
    rows of the session.

    Args:
        data: Measurement file of the new session.
        more: Further sessions; dates from '# date = 2026-06-01' or the file names. Alarms over all of them stay at 5 %.
        same_setup: The instrument and its target were not touched since.
        update: Fit the part that changed to the new session and hold the rest; writes the model to --output.
        output: With --update: the new model file.
        chart: Also write the chart of every part and of the landing error over the sessions, one HTML page.
        seed: Seed of the Monte-Carlo draws that set the limits of significance.
    """
    from pcalib import modelfile
    from pcalib.changes import telling
    from pcalib.changes.history import history
    from pcalib.data import measurement
    from pcalib.errors import InputError
    from pcalib.wording import size

    if update and (output is None or more):
        raise InputError("--update takes one session and writes a model", remedy="add -o NEW.toml, and name one file")
    old = modelfile.load(model, effect_file)
    visits = history(old, [(path, measurement.load(path, old.robot)) for path in (data, *more)], same_setup, seed)
    if more:
        write_json(json, {"schema": "pcalib.changes/1", "sessions": [
            {"file": v.path.name, "date": v.when.isoformat() if v.when else None, "landing_um": 1e6 * v.landing,
             **telling.as_json(v.found)} for v in visits
        ]})  # fmt: skip
        for v in visits:
            landing = f"{size(v.landing)} RMS, noise of the instrument included"
            say(f"{v.label}, lands within {landing}: {telling.sentence(v.found)}")
    else:
        write_json(json, telling.as_json(visits[0].found))
        _show(visits[0].found)
    if chart is not None:
        from pcalib.changes.chart import write

        write(chart, old, visits)
    found = visits[0].found
    if update:
        assert output is not None
        _update(old, found, same_setup, output, data)
    elif not more and found.sets:
        rivals = ["+".join(e.names) for e in found.sets[:2] if not e.slips]
        if found.verdict == "ambiguous" and len(rivals) == 2:
            between = ("--between", ",".join(rivals), "-n", "6", "-o", "more.csv")
            say_next("next", data, "--model", model, *between, why="to plan poses that tell them apart")
        why = "to fit what changed, and hold the rest"
        say_next("changed", data, "--model", model, "--update", "-o", f"{data.stem}.toml", why=why)
    if chart is not None:
        say(f"Chart written to {chart}.")
    return None


def _show(found: Changes) -> None:
    from pcalib.changes import telling

    say(telling.sentence(found))
    print()
    for line in telling.lines(found):
        say(f"- {line}")
    if rows := telling.rows(found):
        show_table(telling.TABLE, rows, title="Each on its own")


def _update(old: Model, found: Changes, same_setup: bool, output: Path, source: Path) -> None:
    """Write the model with the part that changed fitted anew."""
    from pcalib import modelfile
    from pcalib.changes.update import update
    from pcalib.errors import InputError
    from pcalib.wording import size

    if not found.sets:
        why = "nothing changed" if found.verdict == "nothing_changed" else "no part explains what changed"
        raise InputError(f"there is nothing to update: {why}", remedy="to recalibrate everything: pcalib fit")
    parts = [m.candidate.hypothesis if m.slip is None else m.slip.hypothesis for m in found.sets[0].members]
    made = update(old, found.session.data, parts, same_setup)
    names = ", ".join(h.name for h in parts)
    entry = modelfile.snapshot(made.model, "update", effect=names, data=source.name, rms_pos_um=made.rms_after * 1e6)
    modelfile.save(output, replace(made.model, history=(*old.history, entry)))
    say(
        f"Fitted anew: {names}; everything else keeps its value within the model's uncertainty. RMS on this session "
        f"{size(made.rms_after)}, before {size(made.rms_before)}. Model written to {output}."
    )
