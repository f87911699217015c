"""Where a model and measurements differ, and whether it is more than noise.

pcalib compare data.csv --model m.toml
pcalib compare data.csv --model m.toml --report compare.html --rrd compare.rrd
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pcalib.cli._inputs import EffectFiles, ModelOption
from pcalib.cli._next import say_next, to_compensate
from pcalib.cli.frame import BesideOption, JsonOption, say, show_table, write_json

if TYPE_CHECKING:
    from pcalib.fitting.identification import Accuracy


def command(
    data: Path,
    /,
    *,
    model: ModelOption,
    report: BesideOption = None,
    cell: str = "",
    rrd: BesideOption = None,
    residuals: BesideOption = None,
    effect_file: EffectFiles = (),
    json: JsonOption = None,
) -> int | None:
    """Where a model and measurements differ, and whether it is more than noise.

    Shows errors of the rows to fit and of those held out, in units of the noise; the worst poses; and the map of
    channels and variables in which residuals are more than noise.

    Args:
        data: Measurement file, CSV or Parquet.
        report: Also write a report, one self-contained HTML file.
        cell: CHANNEL:VARIABLE of the map, e.g. actuator:temp_arms: the report begins with its points.
        residuals: Also write a table, CSV or Parquet: one row a pose, each component of its residual in µm and µrad,
            and in units of the noise.
        rrd: Also write a recording for the viewer ('pcalib view FILE').
    """
    from pcalib.cli._inputs import read
    from pcalib.diagnosis import advice, results, telling
    from pcalib.diagnosis.compare import compare, points_of
    from pcalib.errors import InputError
    from pcalib.wording import number, size

    if cell and report is None:
        raise InputError("--cell draws into a report", remedy="name its file with --report")
    calibrated, measured, own = read(model, data, effect_file)
    found = compare(calibrated, measured, own)
    drawn = points_of(found, cell) if cell else None
    write_json(json, results.comparison_json(found))
    if report is not None:  # before anything is printed: a closed pipe loses no file
        from pcalib.diagnosis import page

        page.write_comparison(report, calibrated, measured, found, drawn)
    if residuals is not None:
        from pcalib.data import table
        from pcalib.diagnosis.compare import residual_columns

        table.write(residuals, residual_columns(found, measured))
    if rrd is not None:
        from pcalib.diagnosis import recording

        recording.write_comparison(rrd, calibrated, measured, own, effect_file)
    say(telling.comparison_sentence(found))
    print()
    rows: list[tuple[str, Accuracy, float | None]] = [("fit", found.fit, found.times_noise[0])]
    if found.check is not None:
        rows.append(("check", found.check, found.times_noise[1]))
    show_table(
        ("", "rows", "RMS", "max", "RMS µrad", "times noise"),
        [(n, a.n_rows, size(a.rms_pos), size(a.max_pos), _n(a.rms_rot * 1e6), _n(t, 2)) for n, a, t in rows],
    )
    for line in telling.comparison_details(found):
        say(f"- {line}")
    print()
    show_table(
        ("line", "set", "x mm", "y mm", "z mm", "error", "µrad", "times noise", ""),
        [
            (
                w.line, "check" if w.check else "fit", *(number(1e3 * v, 0) for v in found.position[w.index]),
                size(_norm(w.error[:3])), _n(_norm(w.error[3:]) * 1e6, 0), _n(w.times_noise),
                "far from everything" if w.outlier else "",
            )
            for w in found.worst
        ],
        title="Worst poses",
    )  # fmt: skip
    hot = telling.hot_cells(found.cells)
    if hot:
        show_table(
            ("where", "by", "s", "p"),
            [(telling.channel(c), telling.variable(c), _n(c.s), telling.p_text(c.p)) for c in hot[:6]],
            title="Where residuals are more than noise",
        )
    else:
        say("No place stands out.")
    if report is not None:
        say(f"Report written to {report}.")
    if rrd is not None:
        say(f"Recording written to {rrd}.")
    if residuals is not None:
        say(f"Residuals written to {residuals}.")
    if found.set_up_anew is not None:
        say_next("changed", data, "--model", model, why="to find what changed on the robot beside the measuring frame")
    elif hot:
        say_next("diagnose", data, "--model", model, why="to find what the model misses")
    elif telling.stale(found):
        step = advice.mended(found.problem, str(model))
        say_next(*step.words, why=step.why)
    else:
        to_compensate(model)
    return None


def _norm(values) -> float:
    import numpy as np

    return float(np.sqrt(np.nansum(values**2))) if np.isfinite(values).any() else float("nan")


def _n(value: float | None, digits: int = 1) -> str:
    return f"{value:.{digits}f}" if value is not None and value == value else "–"
