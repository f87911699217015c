"""What the commands of a diagnosis read: a model, its data, and effects of the user's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pcalib.data.measurement import Measurements
from pcalib.effects.base import Effect
from pcalib.model import Model

ModelOption = Annotated[Path, Parameter(name=["--model", "-m"], help="Model file, as 'pcalib fit' writes it.")]
EffectFiles = Annotated[
    tuple[str, ...],
    Parameter(
        name="--effect-file",
        help="file.py:Class of an effect of your own, to load and consider; may be given several times.",
    ),
]


def read(model: Path, data: Path, effect_files: tuple[str, ...]) -> tuple[Model, Measurements, list[Effect]]:
    """The model, the measurements, and the user's own effects beyond those that the model has.

    Raises:
        InputError: the data cannot be compared with the model: mixed-up columns, commands that it cannot take.
    """
    from pcalib import effects, modelfile
    from pcalib.data import measurement
    from pcalib.fitting import sufficiency

    calibrated = modelfile.load(model, effect_files)
    measured = measurement.load(data, calibrated.robot)
    sufficiency.require_usable(calibrated, measured)
    present = {fitted.effect.name for fitted in calibrated.effects}
    own = [effects.parse(spec, calibrated.robot) for spec in effect_files]
    return calibrated, measured, [effect for effect in own if effect.name not in present]
