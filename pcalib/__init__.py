"""Calibration of parallel robots built of rods: identify every rod, compensate the command, find the missing physics.

    robot = pcalib.load_robot("models/delta.toml")
    data = pcalib.load_measurements("data.csv", robot)
    fit = pcalib.fit(data, robot, "complete")
    commands = pcalib.compensate(fit.model, targets, tool=[0, 0, -0.3])

The names below are the public interface; everything else may change. Each is imported when it is
first used. docs/python.md shows the whole loop.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from pcalib.shown import Shown

__version__ = "0.1.0"

if TYPE_CHECKING:
    from pcalib.changes.search import changes as changed
    from pcalib.changes.update import update as update
    from pcalib.compensation import Compensated as Compensated
    from pcalib.compensation import compensate as compensate
    from pcalib.data.measurement import Measurements as Measurements
    from pcalib.data.measurement import load as load_measurements
    from pcalib.data.measurement import save as save_measurements
    from pcalib.diagnosis.compare import compare as compare
    from pcalib.diagnosis.diagnose import diagnose as diagnose
    from pcalib.diagnosis.discriminate import next_rows as next_rows
    from pcalib.diagnosis.evidence import evidence as explain
    from pcalib.diagnosis.steps import add as add
    from pcalib.diagnosis.steps import drop as drop
    from pcalib.effects.base import Contribution as Contribution
    from pcalib.effects.base import Effect as Effect
    from pcalib.effects.base import EffectParameter as EffectParameter
    from pcalib.effects.base import Situation as Situation
    from pcalib.errors import PcalibError as PcalibError
    from pcalib.fitting.identification import Fit as Fit
    from pcalib.fitting.identification import fit as fit
    from pcalib.model import Model as Model
    from pcalib.modelfile import load as load_model
    from pcalib.modelfile import save as save_model
    from pcalib.planning import plan as plan
    from pcalib.prediction import Conditions as Conditions
    from pcalib.prediction import predict as predict
    from pcalib.robot import Robot as Robot
    from pcalib.robot import load as load_robot

_PUBLIC = {
    "Compensated": "compensation.Compensated",
    "Conditions": "prediction.Conditions",
    "Contribution": "effects.base.Contribution",
    "Effect": "effects.base.Effect",
    "EffectParameter": "effects.base.EffectParameter",
    "Fit": "fitting.identification.Fit",
    "Measurements": "data.measurement.Measurements",
    "Model": "model.Model",
    "PcalibError": "errors.PcalibError",
    "Robot": "robot.Robot",
    "Situation": "effects.base.Situation",
    "add": "diagnosis.steps.add",
    "changed": "changes.search.changes",
    "compare": "diagnosis.compare.compare",
    "compensate": "compensation.compensate",
    "diagnose": "diagnosis.diagnose.diagnose",
    "drop": "diagnosis.steps.drop",
    "explain": "diagnosis.evidence.evidence",
    "fit": "fitting.identification.fit",
    "load_measurements": "data.measurement.load",
    "load_model": "modelfile.load",
    "load_robot": "robot.load",
    "next_rows": "diagnosis.discriminate.next_rows",
    "plan": "planning.plan",
    "predict": "prediction.predict",
    "save_measurements": "data.measurement.save",
    "save_model": "modelfile.save",
    "update": "changes.update.update",
}
"""Public names, and where they are defined."""
__all__ = [
    "Compensated", "Conditions", "Contribution", "Effect", "EffectParameter", "Fit", "Measurements", "Model",
    "PcalibError", "Robot", "Situation", "__version__", "add", "changed", "compare", "compensate", "diagnose",
    "drop", "explain", "fit", "load_measurements", "load_model", "load_robot", "next_rows", "plan", "predict",
    "save_measurements", "save_model", "update",
]  # fmt: skip

Shown.notebook = staticmethod(lambda: importlib.import_module("pcalib.notebook"))


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'pcalib' has no attribute '{name}'; public names: {', '.join(sorted(_PUBLIC))}")
    module, _, attribute = _PUBLIC[name].rpartition(".")
    return getattr(importlib.import_module(f"pcalib.{module}"), attribute)


def __dir__() -> list[str]:
    return sorted(__all__)
