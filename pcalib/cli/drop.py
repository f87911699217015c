"""Take an effect out of a model again, and see what that changes.

pcalib drop drive_compliance data.csv --model m.toml
pcalib drop backlash data.csv --model m.toml -o m3.toml
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli._inputs import EffectFiles, ModelOption
from pcalib.cli.frame import JsonOption, RewriteOption, write_json


def command(
    effect: str,
    data: Path,
    /,
    *,
    model: ModelOption,
    output: RewriteOption = None,
    effect_file: EffectFiles = (),
    json: JsonOption = None,
) -> int | None:
    """Take an effect out of a model again, and see what that changes.

    Everything else is fitted again. To go back without data, use 'pcalib log MODEL --back-to STEP'.

    Args:
        effect: Name of an effect that the model has.
        data: Measurement file, CSV or Parquet.
        output: Model file to write; the same file when absent.
    """
    from pcalib.cli._inputs import allowing, read
    from pcalib.cli._steps import finish
    from pcalib.diagnosis import results, steps

    effect_file = allowing(effect, effect_file)
    calibrated, measured, _ = read(model, data, effect_file)
    step = steps.drop(calibrated, measured, effect)
    write_json(json, results.step_json(step))
    finish(step, calibrated, data, output or model, effect_files=effect_file)
    return None
