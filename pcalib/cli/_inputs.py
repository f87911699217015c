"""What the commands of a diagnosis read: a model, its data, and effects of the user's own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from pcalib.cli.frame import Reads
from pcalib.data.measurement import Measurements
from pcalib.effects.base import Effect
from pcalib.errors import InputError
from pcalib.model import Model

ModelOption = Annotated[Path, Parameter(name=["--model", "-m"], help="Model file, as 'pcalib fit' writes it.")]


def own_effects(_: Any, specs: tuple[str, ...]) -> None:
    """Refuse a spec without a file: effects of the library are known without being named."""
    for spec in specs:
        if ".py" not in spec:
            raise InputError(
                f"--effect {spec}: this names no file", remedy="write file.py:Class; the library is known without"
            )


def file_of(spec: str) -> str:
    """The file of an effect of the user's own; '' for one of the library."""
    return spec.rpartition(":")[0]


EffectSpec = Annotated[str, Reads(file_of)]
EffectFiles = Annotated[
    tuple[str, ...],
    Reads(file_of),
    Parameter(
        name=["--effect", "--effect-file"],
        validator=own_effects,
        help="file.py:Class of an effect of your own that may be loaded; may be given several times.",
    ),
]


def allowing(effect: str, effect_files: tuple[str, ...]) -> tuple[str, ...]:
    """The user's own effects that may be loaded, with the one that the command line names, if it names one."""
    return (*effect_files, effect) if ".py" in effect and effect not in effect_files else effect_files


def read(
    model: Path, data: Path, effect_files: tuple[str, ...], held_out: bool = False
) -> tuple[Model, Measurements, list[Effect]]:
    """The model, the measurements, and the user's own effects beyond those that the model has.

    Args:
        held_out: whether a file may have only rows that are held out.

    Raises:
        InputError: the data cannot be compared with the model: mixed-up columns, commands that it cannot take.
    """
    from pcalib import effects, modelfile
    from pcalib.data import measurement
    from pcalib.fitting import linearisation, sufficiency

    calibrated = modelfile.load(model, effect_files)
    measured = measurement.load(data, calibrated.robot)
    used = measured
    if held_out and measured.check.all():
        used = replace(measured, check=np.zeros(len(measured), bool))
    sufficiency.require_rows(used)
    calibrated = linearisation.seen_from(calibrated, used.take(~used.check))
    sufficiency.require_usable(calibrated, used)
    present = {fitted.effect.name for fitted in calibrated.effects}
    own = [effects.parse(spec, calibrated.robot) for spec in effect_files]
    return calibrated, measured, [effect for effect in own if effect.name not in present]
