"""Identify a robot's geometry, and effects named, from measured poses.

    pcalib fit data.csv --robot models/delta.toml -o m.toml
    pcalib fit data.csv --robot models/delta.toml --level model24 -o m24.toml
    pcalib fit data.csv --robot models/delta.toml --effect drive_compliance -o m.toml --json fit.json
    pcalib fit data.csv --robot models/delta.toml --fix l11,l12 --loss huber -o m.toml
    pcalib fit data.csv --robot models/hexapod.toml --folds 6
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from pcalib.cli._next import after_fit
from pcalib.cli.frame import BesideOption, JsonOption, OutputOption, progress, quantity, say, show_table, write_json

if TYPE_CHECKING:
    from pcalib.data.measurement import Measurements
    from pcalib.errors import FitError
    from pcalib.fitting.identification import Fit
    from pcalib.model import FittedEffect
    from pcalib.robot import Robot


def command(
    data: Path,
    /,
    *,
    robot: Path,
    output: OutputOption = None,
    level: str = "complete",
    effect: tuple[str, ...] = (),
    method: str = "map",
    loss: str = "linear",
    fix: tuple[str, ...] = (),
    bound: tuple[str, ...] = (),
    length_tolerance: Annotated[np.ndarray | None, quantity("length")] = None,
    angle_tolerance: Annotated[np.ndarray | None, quantity("angle")] = None,
    folds: int = 0,
    far: bool = False,
    report: BesideOption = None,
    json: JsonOption = None,
) -> int | None:
    """Identify a robot's geometry, and effects named, from measured poses.

    Rows with set = check are held out: they are predicted, never fitted. A fit that did not converge, or that the
    data cannot support, is refused (exit code 2): no model is written, and the JSON says why. So are data that are
    misread, or more than 10 mm, 5° or 10 % from the drawing, until --far says that this is meant.

    Args:
        data: Measurement file, CSV or Parquet.
        robot: Robot file (TOML), or the name of a robot of models/: delta.
        output: Model file to write.
        level: Geometry level: nominal, classical, model24 or complete; further ones by robot kind (docs/robots.md).
        effect: Effect to identify too: NAME, NAME:arm, or file.py:Class; may be given several times.
        method: map (priors), base (identifiable base, no priors) or linear (the paper's one step).
        loss: linear, huber or cauchy; the latter two weigh rows far off down, and report them.
        fix: Parameters held at nominal, separated by commas.
        bound: NAME=LOW,HIGHunit: bounds on a parameter's change from nominal, e.g. l11=-0.5,0.5mm.
        length_tolerance: 1σ manufacturing prior of lengths; 0.1mm when absent.
        angle_tolerance: 1σ manufacturing prior of angles; 0.05deg when absent.
        folds: Cross-validate too: fit this many times without a part of the rows, which is predicted.
        report: Also write a report, one self-contained HTML file.
        far: Fit data all the same that are misread or very far from the drawing.
    """
    from pcalib import findings, modelfile, summary
    from pcalib import robot as robots
    from pcalib.data import measurement
    from pcalib.diagnosis import visibility
    from pcalib.errors import FitError, InputError
    from pcalib.fitting import as_drawn, crossvalidation, identification, mixups, trust
    from pcalib.model import Model
    from pcalib.uncertainty import assessed, outlook
    from pcalib.wording import size

    described = robots.load(robot)
    measured = measurement.load(data, described)
    if folds:
        crossvalidation.require_folds(measured, folds)
    judged = mixups.judge(measured, described)
    nominal = as_drawn.compare(measured, described)
    said = mixups.sentence(judged, nominal) if judged.tried else ""
    far_off = f"{said}; {mixups.remedy(judged)}."
    refused = {"schema": "pcalib.fit/1", "status": "far", "reason": said, "drawing": judged.to_json()}
    too_far = InputError(said, file=data, remedy=f"{mixups.remedy(judged)}; if it is meant, fit with --far")
    if judged.absurd and judged.named and not far:
        write_json(json, refused)
        raise too_far
    start = Model.nominal(described)
    options: dict[str, Any] = {
        "effects": _effects(effect, measured, described),
        "method": method,
        "loss": loss,
        "fixed": [name.strip() for names in fix for name in names.split(",")],
        "bounds": dict(_bound(text, described, level) for text in bound),
        "prior": _tolerances(length_tolerance, angle_tolerance),
    }
    apart = as_drawn.rows_apart(nominal, measured)
    try:
        found = identification.fit(measured, start, level, **options)
    except FitError as error:
        raise _with_rows(error, data, apart) from error
    content = summary.fit_json(found)
    if found.status != "converged":
        write_json(json, content)
    elif judged.absurd and not judged.named and not far and not found.accuracy.at_the_noise:
        write_json(json, refused)  # nothing explains the distance, and the fit does not vouch for it either
        raise too_far
    try:
        calibrated = assessed(found)  # or the reason why there is none
    except FitError as error:
        raise _with_rows(error, data, apart) from error
    expected, uncertainty = outlook.said(calibrated)
    doubts = trust.doubts(found, measured)
    shares = visibility.visibility(calibrated, measured)
    content |= {
        "doubts": trust.json(doubts), "kappa": shares, "drawing": judged.to_json(), "uncertainty": uncertainty
    }  # fmt: skip
    write_json(json, content)
    if output is not None:  # before anything is printed: a closed pipe loses no model
        figures = summary.statistics(found)
        entry = modelfile.snapshot(calibrated, "fit", data=data.name, **figures)
        modelfile.save(output, replace(calibrated, history=(entry,)), figures)
    if report is not None:
        from pcalib.report import calibration
        from pcalib.uncertainty import maps

        first = [*([far_off] if said else []), expected, *(doubt.sentence() for doubt in doubts)]
        calibration.write_fit(report, found, measured, first, maps.of_model(calibrated))
    if said:
        say(far_off)
    show(found)
    say(f"- {expected}")
    for finding in findings.clock(measured):
        say(f"- {finding.message} {finding.remedy}")
    for doubt in doubts:
        say(f"- {doubt.sentence()}")
    if shares:
        say(f"- {visibility.sentence(shares)}")
    if folds:
        with progress("cross-validating", folds) as advance:
            held = crossvalidation.cross_validate(measured, start, level, folds, tick=advance, **options)
        content["cross_validation"] = held.json()
        write_json(json, content)
        rods = f"; apparent rod-length errors {size(held.rms_rod)}" if held.rms_rod == held.rms_rod else ""
        say(f"Cross-validated in {folds} folds: {size(held.rms_pos)} RMS at poses not fitted{rods}.")
    if output is not None:
        say(f"Model written to {output}.")
    if report is not None:
        say(f"Report written to {report}.")
    chosen = ["--level", level] if level != "complete" else []
    chosen += [word for spec in effect for word in ("--effect", spec)]
    chosen += [word for names in fix for word in ("--fix", names)]
    chosen += [word for text in bound for word in ("--bound", text)]
    after_fit(found, data, robot, output, chosen)
    return None


def _tolerances(length: np.ndarray | None, angle: np.ndarray | None) -> dict[str, float]:
    """1σ manufacturing priors by unit."""
    from pcalib.errors import InputError

    out = {}
    for unit, option, value in (("m", "--length-tolerance", length), ("rad", "--angle-tolerance", angle)):
        if value is not None:
            if not value[0] > 0:
                remedy = "to hold parameters at nominal, use --fix or another --level"
                raise InputError(f"{option} must be more than 0", remedy=remedy)
            out[unit] = float(value[0])
    return out


def _with_rows(error: FitError, data: Path, apart: str) -> FitError:
    """The error with the rows that are most likely behind it."""
    from pcalib.errors import FitError

    if not apart:
        return error
    return FitError(f"{data}: the fit is not usable: {apart[0].lower()}{apart[1:]}\n  correct or leave out these rows")


def _effects(specs: tuple[str, ...], measured: Measurements, robot: Robot) -> list[FittedEffect]:
    """Effects named on the command line, each once."""
    from pcalib.errors import InputError

    out = [start_effect(spec, robot, measured) for spec in specs]
    names = [fitted.effect.name for fitted in out]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"--effect {name} is given twice", remedy="name one of its variants")
    return out


def start_effect(spec: str, robot: Robot, measured: Measurements) -> FittedEffect:
    """An effect named on the command line, at zero, checked against the data's columns."""
    from pcalib import effects
    from pcalib.model import FittedEffect

    effect = effects.parse(spec, robot)
    effects.require(effect, measured.columns, measured.source)
    return FittedEffect(effect, np.zeros(len(effect.parameters)), spec)


def _bound(text: str, robot: Robot, level: str) -> tuple[str, tuple[float, float]]:
    from pcalib import units
    from pcalib.errors import InputError, unknown

    name, equals, values = text.partition("=")
    if not equals:
        raise InputError(f"--bound '{text}': write NAME=LOW,HIGHunit", remedy="for example l11=-0.5,0.5mm")
    levels = robot.mechanism.levels
    if level not in levels:
        raise InputError(unknown("level", level, levels))
    chosen = levels[level]
    if name not in chosen.columns:
        raise InputError(unknown(f"parameter of level {level}", name, chosen.columns))
    dimension = {"m": "length", "rad": "angle", "1": "ratio"}[chosen.units[chosen.columns.index(name)]]
    low_high = units.parse_quantity(values, dimension, option=f"--bound {name}")
    if len(low_high) != 2 or not low_high[0] < low_high[1]:
        raise InputError(f"--bound '{text}': two numbers are needed, low before high", remedy="e.g. l11=-0.5,0.5mm")
    return name, (float(low_high[0]), float(low_high[1]))


def show(found: Fit) -> None:
    """Print a fit: the outcome in a sentence, its figures, what moved most, and what to know."""
    from pcalib import rotation, summary
    from pcalib.wording import size

    say(found.headline())
    print()
    show_table(
        ("", "rows", "RMS", "max", "RMS µrad", "χ²/dof"),
        [
            (name, a.n_rows, size(a.rms_pos), size(a.max_pos), _n(a.rms_rot * 1e6), _n(a.chi2_dof, 2))
            for name, a in (("fit", found.accuracy), ("check", found.check))
            if a is not None
        ],
    )
    say(summary.identified(found))
    frame = found.candidate.frame
    if frame is not None and frame.turn is not None:
        turn = ", ".join(f"{v:.4g}" for v in np.degrees(rotation.log(frame.turn)))
        say(f"The tracked body's axes are turned by ({turn})° against the plate's, which was estimated with the frame.")
    for fitted in found.candidate.effects:
        say(f"- {fitted.effect.describe(fitted.theta)}")
    moved = summary.largest_changes(found)
    if moved:
        show_table(("moved most", "from nominal", "± 1σ", "in σ"), moved)
    say(found.scale.sentence(found.data.stated, found.data.kinds))
    for warning in found.warnings:
        say(f"- {warning}")


def _n(value: float, digits: int = 1) -> str:
    return f"{value:.{digits}f}" if value == value else "–"
