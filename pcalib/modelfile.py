"""Model files (TOML): a calibrated robot that stands alone, with every step that led to it.

A model file carries its robot file, so that nothing else is needed to use it. Each history entry keeps the values of
its step; going back needs no data.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from pcalib import files, robot, rotation, units
from pcalib.errors import EffectError, InputError
from pcalib.model import FittedEffect, Frame, Model

SCHEMA = "pcalib.model/1"
_EDGE = {"m": ("mm", 1e-3), "rad": ("deg", np.pi / 180), "1": ("", 1.0)}


def edge(name: str, unit: str) -> tuple[str, float]:
    """How a file names a quantity of SI unit 'm', 'rad' or '1': the name with its unit, and the factor to SI."""
    suffix, factor = _EDGE[unit]
    return (f"{name}_{suffix}" if suffix else name), factor


def save(path: str | Path, model: Model, statistics: Mapping[str, Any] | None = None) -> None:
    """Write a model file atomically.

    Args:
        statistics: figures of the fit, shown under [statistics]; they are not read back.
    """
    files.write_text(path, dumps(model, statistics))


def dumps(model: Model, statistics: Mapping[str, Any] | None = None) -> str:
    """The text of a model file."""
    table: dict[str, Any] = {"schema": SCHEMA, "level": model.level}
    if statistics:
        table["statistics"] = {k: _plain(v) for k, v in statistics.items() if v is not None}
    table["effects"] = [_effect_table(f) for f in model.effects]
    if model.frame is not None:
        table["frame"] = _frame_table(model.frame)
    table["parameters"] = {}
    mechanism = model.robot.mechanism
    for i, (name, unit) in enumerate(zip(mechanism.parameters, mechanism.units, strict=True)):
        entry = {}
        for key, values in (("nominal", mechanism.nominal), ("value", model.k), ("sigma", model.sigma)):
            if values is not None and np.isfinite(values[i]):
                label, factor = edge(key, unit)
                entry[label] = float(values[i] / factor)
        table["parameters"][name] = entry
    table["history"] = [_plain(h) for h in model.history]
    table["robot"] = tomllib.loads(model.robot.text)
    return tomli_w.dumps(table)


def load(path: str | Path, effect_files: Iterable[str] = ()) -> Model:
    """Read a model file.

    Args:
        effect_files: specs `file.py:Class` of the user's own effects that may be loaded. Code is never loaded
            because a model file says so.

    Raises:
        InputError: not a model file, or one that does not fit its own robot.
        EffectError: the model uses an effect of the user's own that was not named.
    """
    return loads(files.read_text(path), path, effect_files)


def loads(text: str, source: str | Path = "model", effect_files: Iterable[str] = ()) -> Model:
    """A model from the text of its file."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not valid TOML: {error}", file=source, remedy="write one with 'pcalib fit … -o'") from None
    if table.get("schema") != SCHEMA:
        said = f"schema '{table['schema']}'" if "schema" in table else "no schema"
        raise InputError(
            f"not a model file ({said}, wanted '{SCHEMA}')", file=source, remedy="write one with 'pcalib fit … -o'"
        )
    try:
        return _from_table(table, list(effect_files))
    except InputError as error:
        raise InputError(error.problem, file=source, remedy=error.remedy) from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"damaged model file: {type(error).__name__} {error}", file=source, remedy="fit again with 'pcalib fit'"
        ) from None


def _from_table(table: Mapping[str, Any], effect_files: list[str]) -> Model:
    described = robot.from_table(table["robot"], tomli_w.dumps(table["robot"]))
    mechanism = described.mechanism
    given = table["parameters"]
    for name in given:
        if name not in mechanism.parameters:
            raise InputError(f"parameter '{name}' is not one of robot kind {described.kind}")
    k, sigma = mechanism.nominal.copy(), np.full(len(mechanism.nominal), np.nan)
    for i, (name, unit) in enumerate(zip(mechanism.parameters, mechanism.units, strict=True)):
        entry = given.get(name, {})
        for key, target in (("value", k), ("sigma", sigma)):
            label, factor = edge(key, unit)
            if label in entry:
                target[i] = float(entry[label]) * factor
    if not np.isfinite(k).all():
        raise InputError("a parameter value is not a finite number")
    level = table["level"]
    if level not in mechanism.levels:
        raise InputError(f"level '{level}' is not one of {', '.join(mechanism.levels)}")
    effects = tuple(_effect_from(entry, described, effect_files) for entry in table.get("effects", []))
    frame = _frame_from(table["frame"]) if "frame" in table else None
    known = sigma if np.isfinite(sigma).any() else None
    return Model(described, k, level, effects, frame, known, tuple(table.get("history", [])))


def snapshot(model: Model, action: str, **figures: Any) -> dict[str, Any]:
    """A history entry: what was done, what came out, and the values to go back to."""
    entry: dict[str, Any] = {"action": action, "level": model.level, **figures}
    entry["k_si"] = model.k.tolist()
    entry["effects"] = [_effect_table(f) for f in model.effects]
    if model.frame is not None:
        entry["frame"] = _frame_table(model.frame)
    return _plain(entry)


def restore(model: Model, entry: Mapping[str, Any], effect_files: Sequence[str] = ()) -> Model:
    """The model as it was after a history entry; the history itself stays."""
    return replace(
        model,
        k=np.array(entry["k_si"], float),
        level=entry["level"],
        effects=tuple(_effect_from(e, model.robot, list(effect_files)) for e in entry["effects"]),
        frame=_frame_from(entry["frame"]) if "frame" in entry else None,
        sigma=None,
    )


def _effect_table(fitted: FittedEffect) -> dict[str, Any]:
    out: dict[str, Any] = {"spec": fitted.spec or fitted.effect.name}
    for i, p in enumerate(fitted.effect.parameters):
        factor = units.UNITS[p.unit].factor if p.unit in units.UNITS else 1.0
        out[f"{p.name}_{p.unit}"] = float(fitted.theta[i] / factor)
        if fitted.sigma is not None and np.isfinite(fitted.sigma[i]):
            out[f"{p.name}_sigma_{p.unit}"] = float(fitted.sigma[i] / factor)
    return out


def _effect_from(entry: Mapping[str, Any], described: robot.Robot, effect_files: list[str]) -> FittedEffect:
    from pcalib import effects

    spec = entry["spec"]
    if ".py" in spec:
        named = [f for f in effect_files if Path(f.rpartition(":")[0]).name == Path(spec.rpartition(":")[0]).name]
        if not named:
            raise EffectError(
                f"the model uses an effect of your own, {spec}; code is loaded only when you name it:\n"
                f"  add --effect-file {spec}"
            )
        effect = effects.parse(named[0], described)
    else:
        effect = effects.parse(spec, described)
    theta, sigma = [], []
    for p in effect.parameters:
        factor = units.UNITS[p.unit].factor if p.unit in units.UNITS else 1.0
        theta.append(float(entry[f"{p.name}_{p.unit}"]) * factor)
        sigma.append(float(entry.get(f"{p.name}_sigma_{p.unit}", np.nan)) * factor)
    return FittedEffect(effect, np.array(theta), spec, np.array(sigma))


def _frame_table(frame: Frame) -> dict[str, Any]:
    return {
        "translation_mm": (frame.translation * 1e3).tolist(),
        "rotation_deg": np.degrees(rotation.log(frame.rotation)).tolist(),
        "target_offset_mm": (frame.offset * 1e3).tolist(),
    }


def _frame_from(table: Mapping[str, Any]) -> Frame:
    return Frame(
        rotation.exp(np.radians(np.array(table["rotation_deg"], float))),
        np.array(table["translation_mm"], float) * 1e-3,
        np.array(table["target_offset_mm"], float) * 1e-3,
    )


def _plain(value: Any) -> Any:
    """Numpy scalars and arrays as what TOML knows; None entries dropped."""
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value
