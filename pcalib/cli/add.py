"""Refit a model with one effect more, and see what it changes.

pcalib add drive_compliance data.csv --model m.toml
pcalib add backlash:arm data.csv --model m.toml -o m2.toml
pcalib add complete data.csv --model model24.toml
pcalib add worm_gear.py:WormGear data.csv --model m.toml
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pcalib.cli._inputs import EffectFiles, EffectSpec, ModelOption
from pcalib.cli.frame import BesideOption, JsonOption, RewriteOption, write_json

if TYPE_CHECKING:
    from pcalib.model import Model


def command(
    effect: EffectSpec,
    data: Path,
    /,
    *,
    model: ModelOption,
    output: RewriteOption = None,
    effect_file: EffectFiles = (),
    report: BesideOption = None,
    json: JsonOption = None,
) -> int | None:
    """Refit a model with one effect more, and see what it changes.

    Geometry, effects and measuring frame are fitted again together. The model file keeps every step: 'pcalib log' shows
    them, 'pcalib drop' and 'pcalib log --back-to' undo them.

    Args:
        effect: NAME, NAME:arm, NAME:rod, a geometry level, or file.py:Class of your own.
        data: Measurement file, CSV or Parquet.
        output: Model file to write; the same file when absent.
        report: Also write a report of the new fit, one self-contained HTML file.
    """
    from pcalib.cli._inputs import allowing, read
    from pcalib.cli._steps import finish
    from pcalib.diagnosis import results, steps
    from pcalib.uncertainty import rivals

    effect_file = allowing(effect, effect_file)
    calibrated, measured, own = read(model, data, effect_file)
    step = steps.add(calibrated, measured, effect, own)
    content = results.step_json(step)
    write_json(json, content)

    def with_rivals(fitted: Model) -> Model:
        return rivals.kept(fitted, step.before.candidate, measured, effect, own)

    expected = finish(step, calibrated, data, output or model, report, measured, effect_file, with_rivals)
    write_json(json, content | {"uncertainty": expected})
    return None
