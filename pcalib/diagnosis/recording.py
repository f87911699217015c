"""The story of a model for the viewer: a step per model on one timeline, with what each left to explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcalib import modelfile, view
from pcalib.data.measurement import Measurements
from pcalib.diagnosis import telling
from pcalib.diagnosis.diagnose import Diagnosis, diagnose
from pcalib.diagnosis.evidence import by_variable_of
from pcalib.effects.base import Effect
from pcalib.errors import InputError
from pcalib.fitting import linearisation
from pcalib.ladder import CandidateBar, ErrorMap, Ladder, ResidualPlot, Step
from pcalib.model import Model

N_DRAWS = 1024


def story(model: Model, data: Measurements, own: Sequence[Effect] = (), effect_files: Sequence[str] = ()) -> Ladder:
    """The models of a history on one data set: as drawn, then every step, each with what it leaves to explain.

    The error field is measured − predicted at the measured poses; in the map of each tool.
    """
    steps = [Step("nominal", "As drawn", Model.nominal(model.robot), "none", "The robot of the drawing.")]
    frame = model.frame if data.frame == "tracker" else None  # the drawing has no place there: take the model's
    models = [replace(Model.nominal(model.robot), frame=frame, setup=model.setup)]
    past = [modelfile.restore(model, entry, effect_files) for entry in model.history] or [model]
    for i, then in enumerate(past):
        entry = model.history[i] if model.history else {}
        models.append(then)
        steps.append(_step(i, then, data, own, str(entry.get("action", "model")), str(entry.get("effect", ""))))
    found = [linearisation.residuals(m, data) for m in models]
    errors = np.stack([linearisation.in_space(error, p)[:, :3] for error, p in found])
    status = np.where(np.isfinite(errors).any(axis=-1), "ok", "not measured")
    # Of a reading in part (a height, say) only that part can be off, and the model says where it was taken.
    errors = np.where(status[..., None] == "ok", np.nan_to_num(errors), np.nan)
    place = data.position if data.frame == "base" else _in_base(model, data)
    last = found[-1][1]
    place = np.where(np.isfinite(place), place, last.pose.tcp(last.tool))
    tools, which = np.unique(np.round(data.tool, 6), axis=0, return_inverse=True)
    maps = tuple(
        ErrorMap(
            tool,
            place[which == t],
            np.where(status[:, which == t, None] == "ok", errors[:, which == t], np.nan),
            status[:, which == t],
        )
        for t, tool in enumerate(tools)
        if np.isfinite(place[which == t]).all(axis=-1).any()
    )
    floor = float(np.sqrt(3) * np.nanmedian(data.sigma[:, :3]))
    return Ladder(model.robot, tuple(steps), maps, "measured − predicted", floor)


def _in_base(model: Model, data: Measurements) -> np.ndarray:
    if model.frame is None:
        raise InputError(
            "the model knows no place of the tracker", file=data.source, remedy="fit it to these data first"
        )
    return (data.position - model.frame.translation) @ model.frame.rotation


def _step(i: int, then: Model, data: Measurements, own: Sequence[Effect], action: str, effect: str) -> Step:
    try:
        found = diagnose(then, data, own, n_draws=N_DRAWS)
    except InputError as error:
        return Step(f"step{i + 1}", f"{action} {effect}".strip(), then, "exact", error.problem)
    ranked = telling.one_per_effect(found)
    known = " and ".join([f"geometry {then.level}", *(f.effect.name for f in then.effects)])
    return Step(
        name=f"step{i + 1}",
        label=f"{action} {effect}".strip(),
        model=then,
        text=f"Knows {known}. {telling.sentence(found)}",
        candidates=tuple(CandidateBar(f.candidate.name, f.s, f.adequate) for f in ranked if f.s > 0)[:12],
        scatter=_scatter(found, data),
    )


def _scatter(found: Diagnosis, data: Measurements) -> ResidualPlot | None:
    plot = by_variable_of(found, data)
    if plot is None:
        return None
    worst = int(np.argmax([np.ptp(plot.curve[plot.series == i]) for i in range(len(plot.names))]))
    mine = plot.series == worst
    order = np.argsort(plot.x[mine])
    factor, variable = plot.axis
    noise = max(float(np.std(plot.y[mine] - plot.curve[mine])), 1e-12)
    x = plot.x[mine][order] * factor
    return ResidualPlot(
        variable=variable,
        x=x,
        residual=plot.y[mine][order] / noise,
        label=f"{plot.channel} {plot.names[worst]}",
        curve=np.stack([x, plot.curve[mine][order] / noise], axis=-1),
    )


def write_comparison(
    path: Path, model: Model, data: Measurements, own: Sequence[Effect] = (), effect_files: Sequence[str] = ()
) -> None:
    """Write the story as a recording.

    Raises:
        InputError: the file cannot be written, or the viewer's package is not there.
    """
    view.write(path, story(model, data, own, effect_files), model=model)
