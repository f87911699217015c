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
from pcalib.errors import EffectError, InputError, unknown
from pcalib.mechanics.mechanism import Level, Mechanism
from pcalib.model import LOSSES, METHODS, FitOptions, FittedEffect, Frame, Model
from pcalib.posterior import Posterior
from pcalib.sensors.base import Block
from pcalib.settings import ABSENT, Setting, is_number, read
from pcalib.unexplained import Unexplained

SCHEMA = "pcalib.model/1"
_AGAIN = "the file is damaged or was edited: write it anew with 'pcalib fit … -o'"
_LARGEST = 1e100
"""Numbers beyond this are no numbers of a robot, and overflow when they are squared, whatever their unit."""
_CHOICES = {"method": METHODS, "loss": LOSSES}
"""Accepted values of the options of a fit; the first is the default."""
_EDGE = {"m": ("mm", 1e-3), "rad": ("deg", np.pi / 180), "1": ("", 1.0)}
_PARAMETER = {
    unit: (
        Setting("nominal", dimension, ABSENT),
        Setting("value", dimension, low=-_LARGEST, high=_LARGEST),
        Setting("sigma", dimension, np.nan, low=0.0, high=_LARGEST),
    )
    for unit, dimension in (("m", "length"), ("rad", "angle"), ("1", "number"))
}
"""What the section of a parameter holds, by its SI unit."""
_FRAME = tuple(
    Setting(name, dimension, low=-_LARGEST, high=_LARGEST, count=3)
    for name, dimension in (("translation", "length"), ("rotation", "angle"), ("target_offset", "length"))
)
_TURN = Setting("target_turn", "angle", default=ABSENT, low=-_LARGEST, high=_LARGEST, count=3)


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
    if options := _options_table(model.options):
        table["options"] = options
    if model.time_origin is not None:
        table["time_origin_s"] = model.time_origin
    table["effects"] = [_effect_table(f) for f in model.effects]
    if model.frame is not None:
        table["frame"] = _frame_table(model.frame)
    if model.setup:
        table["setup"] = _setup_table(model.setup)
    table["parameters"] = {}
    mechanism = model.robot.mechanism
    for i, (name, unit) in enumerate(zip(mechanism.parameters, mechanism.units, strict=True)):
        entry = {}
        for key, values in (("nominal", mechanism.nominal), ("value", model.k), ("sigma", model.sigma)):
            if values is not None and np.isfinite(values[i]):
                label, factor = edge(key, unit)
                entry[label] = float(values[i] / factor)
        table["parameters"][name] = entry
    if model.posterior is not None and model.posterior.names == model.unknowns:
        table["posterior"] = model.posterior.to_table()
        if model.uncertainty is not None:
            table["uncertainty"] = _plain(model.uncertainty.to_table())
    table["history"] = [_plain(h) for h in model.history]
    if not model.robot.text:
        raise InputError(f"robot '{model.robot.name}' came from no file", remedy="read it with pcalib.robot.load")
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
    table = files.parse_toml(text, source, "write one with 'pcalib fit … -o'")
    if table.get("schema") != SCHEMA:
        said = f"schema '{table['schema']}'" if "schema" in table else "no schema"
        raise InputError(
            f"not a model file ({said}, wanted '{SCHEMA}')", file=source, remedy="write one with 'pcalib fit … -o'"
        )
    try:
        with files.locating(text, source, _AGAIN):
            return _from_table(table, list(effect_files))
    except EffectError as error:
        raise EffectError(f"{source}: {error}") from None


def _from_table(table: Mapping[str, Any], effect_files: list[str]) -> Model:
    plain = _table(table, "robot")
    described = robot.from_table(plain, tomli_w.dumps(plain))
    mechanism = described.mechanism
    given = _table(table, "parameters")
    for name in given:
        if name not in mechanism.parameters:
            raise InputError(f"parameter '{name}' is not one of robot kind {described.kind}", key=name)
    k, sigma = np.empty(len(mechanism.parameters)), np.full(len(mechanism.parameters), np.nan)
    for i, (name, unit) in enumerate(zip(mechanism.parameters, mechanism.units, strict=True)):
        entry = read(_table(given, name, "parameters."), _PARAMETER[unit], f"parameters.{name}")
        k[i], sigma[i] = entry["value"], entry["sigma"]
    effects = tuple(_effect_from(entry, described, effect_files) for entry in _tables(table, "effects"))
    frame = _frame_from(_table(table, "frame")) if "frame" in table else None
    known = sigma if np.isfinite(sigma).any() else None
    level = _level(table, mechanism)
    options = _options_from(table, mechanism.levels[level])
    times = {key: value for key, value in table.items() if key == "time_origin_s"}
    origin = read(times, (Setting("time_origin", "time", ABSENT),), "model").get("time_origin")
    made = Model(described, k, level, effects, frame, known, None, options, origin, _history(table))
    made = replace(made, setup=_setup_from(table))
    if "posterior" not in table:  # files of earlier versions have none
        return made
    made = replace(made, posterior=Posterior.from_table(_table(table, "posterior"), made.unknowns))
    if "uncertainty" not in table:
        return made
    kept = Unexplained.from_table(_table(table, "uncertainty"), len(mechanism.actuators))
    return replace(made, uncertainty=kept)


def _history(table: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """The steps, each with what a list of them shows of the right kind."""
    entries = _tables(table, "history")
    for number, entry in enumerate(entries, 1):
        where = f"history entry {number}"
        _tables(entry, "effects", f"{where}: ")
        check = _table(entry, "check", f"{where}: ") if "check" in entry else {}
        for figures, key in ((entry, "rms_pos_um"), (entry, "chi2_dof"), (check, "rms_pos_um")):
            if not isinstance(figures.get(key, 0.0), (int, float)):  # inf and nan may come out of a fit
                raise InputError(f"{where}: {key} must be a number, not {figures[key]!r:.40}")
    return tuple(entries)


def snapshot(model: Model, action: str, **figures: Any) -> dict[str, Any]:
    """A history entry: what was done, what came out, and the values to go back to."""
    entry: dict[str, Any] = {"action": action, "level": model.level, **figures}
    if options := _options_table(model.options):
        entry["options"] = options
    entry["k_si"] = model.k.tolist()
    entry["effects"] = [_effect_table(f) for f in model.effects]
    if model.frame is not None:
        entry["frame"] = _frame_table(model.frame)
    if model.setup:
        entry["setup"] = _setup_table(model.setup)
    return _plain(entry)


def restore(model: Model, entry: Mapping[str, Any], effect_files: Sequence[str] = ()) -> Model:
    """The model as it was after a history entry; the history itself stays."""
    level = _level(entry, model.robot.mechanism)
    return replace(
        model,
        k=_vector(entry, "k_si", len(model.k), "history entry"),
        level=level,
        effects=tuple(_effect_from(e, model.robot, list(effect_files)) for e in _tables(entry, "effects")),
        frame=_frame_from(_table(entry, "frame")) if "frame" in entry else None,
        setup=_setup_from(entry),
        options=_options_from(entry, model.robot.mechanism.levels[level]),
        sigma=None,
        posterior=None,
        uncertainty=None,
    )


def _options_table(options: FitOptions) -> dict[str, Any]:
    """The options that differ from the defaults."""
    out = {name: value for name in _CHOICES if (value := getattr(options, name)) != _CHOICES[name][0]}
    for name, value in (("fixed", list(options.fixed)), ("bounds_si", options.bounds), ("prior_si", options.prior)):
        if value:
            out[name] = value
    return _plain(out)


def _options_from(whole: Mapping[str, Any], level: Level) -> FitOptions:
    """The section [options] of a model file or of a history entry; the defaults where there is none."""
    table = _table(whole, "options") if "options" in whole else {}
    for key in table:
        if key not in (*_CHOICES, "fixed", "bounds_si", "prior_si"):
            raise InputError(f"options: {unknown('key', key, (*_CHOICES, 'fixed', 'bounds_si', 'prior_si'))}")
    said: dict[str, Any] = {}
    for name, accepted in _CHOICES.items():
        said[name] = table.get(name, accepted[0])
        if said[name] not in accepted:
            raise InputError(f"options: {unknown(name, str(said[name])[:40], accepted)}")
    fixed = table.get("fixed", [])
    if not isinstance(fixed, list) or not all(isinstance(name, str) for name in fixed):
        raise InputError("options: fixed is no list of names")
    bounds, prior = (_table(table, key, "options: ") if key in table else {} for key in ("bounds_si", "prior_si"))
    out = FitOptions(
        **said,
        fixed=tuple(fixed),
        bounds={name: tuple(_vector(bounds, name, 2, "options: bounds_si").tolist()) for name in bounds},
        prior={name: _sigma(prior, name, "options: prior_si") for name in prior},
    )
    for name in out.named:
        if name not in level.columns:
            raise InputError(f"options: {unknown(f'parameter of level {level.name}', name, level.columns)}")
    for name, (low, high) in out.bounds.items():
        if not low < high:
            raise InputError(f"options: bounds_si: {name}: the low bound is not below the high one")
    return out


def _effect_table(fitted: FittedEffect) -> dict[str, Any]:
    out: dict[str, Any] = {"spec": fitted.spec or fitted.effect.spec}
    for i, p in enumerate(fitted.effect.parameters):
        factor = units.UNITS[p.unit].factor if p.unit in units.UNITS else 1.0
        out[f"{p.name}_{p.unit}"] = float(fitted.theta[i] / factor)
        if fitted.sigma is not None and np.isfinite(fitted.sigma[i]):
            out[f"{p.name}_sigma_{p.unit}"] = float(fitted.sigma[i] / factor)
    return out


def _effect_from(entry: Mapping[str, Any], described: robot.Robot, effect_files: list[str]) -> FittedEffect:
    from pcalib import effects

    spec = entry.get("spec")
    if not isinstance(spec, str):
        raise InputError(f"an effect has no spec, or one that is no text: {spec!r:.40}")
    if ".py" in spec:
        named = [f for f in effect_files if _own(f) == _own(spec)]
        if not named:
            raise EffectError(
                f"the model uses an effect of your own, {spec}; code is loaded only when you name it:\n"
                f"  add --effect {spec}"
            )
        effect = effects.parse(named[0], described)
    else:
        effect = effects.parse(spec, described)
    theta, sigma = [], []
    for p in effect.parameters:
        factor = units.UNITS[p.unit].factor if p.unit in units.UNITS else 1.0
        value, spread = f"{p.name}_{p.unit}", f"{p.name}_sigma_{p.unit}"
        theta.append(_number(entry, value, f"effect {spec}") * factor)
        sigma.append(_sigma(entry, spread, f"effect {spec}") * factor if spread in entry else np.nan)
    known = np.array(sigma) if np.isfinite(sigma).any() else None
    return FittedEffect(effect, np.array(theta), spec, known)


def _own(spec: str) -> tuple[str, str]:
    """File name and class of an effect of the user's own; the folder may change."""
    file, _, name = spec.rpartition(":")
    return Path(file).name, name


def _frame_table(frame: Frame) -> dict[str, Any]:
    table = {
        "translation_mm": (frame.translation * 1e3).tolist(),
        "rotation_deg": np.degrees(rotation.log(frame.rotation)).tolist(),
        "target_offset_mm": (frame.offset * 1e3).tolist(),
    }
    if frame.turn is not None:
        table["target_turn_deg"] = np.degrees(rotation.log(frame.turn)).tolist()
    return table


def _frame_from(table: Mapping[str, Any]) -> Frame:
    said = read(table, (*_FRAME, _TURN), "frame")
    turn = rotation.exp(said["target_turn"]) if "target_turn" in said else None
    return Frame(rotation.exp(said["rotation"]), said["translation"], said["target_offset"], turn)


def _setup_table(setup: Sequence[Block]) -> dict[str, Any]:
    """Every block by its name, with values in mm and degrees."""
    out = {}
    for block in setup:
        named = [edge(p, unit) for p, unit in zip(block.parameters, block.units, strict=True)]
        out[block.name] = {
            label: float(value / factor) for (label, factor), value in zip(named, block.theta, strict=True)
        }
    return out


def _setup_from(table: Mapping[str, Any]) -> tuple[Block, ...]:
    """The blocks of a [setup]; a fit gives them their priors anew, as the sensors of its data have them."""
    out = []
    for name, values in (_table(table, "setup") if "setup" in table else {}).items():
        if not isinstance(values, Mapping):
            raise InputError(f"setup.{name} is no table")
        split = [units.split(key) for key in values]
        for key, (_, unit) in zip(values, split, strict=True):
            if unit is None or unit.dimension not in ("length", "angle") or not is_number(values[key]):
                raise InputError(f"setup.{name}.{key} is no length or angle", remedy="e.g. x_mm = 12.5")
        factors = [unit.factor for _, unit in split if unit]
        theta = np.array([float(value) for value in values.values()]) * factors
        kinds = tuple("m" if unit.dimension == "length" else "rad" for _, unit in split if unit)
        out.append(Block(name, tuple(p for p, _ in split), kinds, np.full(len(theta), np.inf), theta))
    return tuple(out)


def _level(table: Mapping[str, Any], mechanism: Mechanism) -> str:
    level = table.get("level")
    if not isinstance(level, str) or level not in mechanism.levels:
        raise InputError(f"level {level!r:.40} is not one of {', '.join(mechanism.levels)}")
    return level


def _table(table: Mapping[str, Any], key: str, where: str = "") -> Mapping[str, Any]:
    found = table.get(key)
    if not isinstance(found, Mapping):
        raise InputError(f"{where}{key} is missing, or is no table")
    return found


def _tables(table: Mapping[str, Any], key: str, where: str = "") -> list[Mapping[str, Any]]:
    """A list of tables, empty where the key is absent."""
    found = table.get(key, [])
    if not isinstance(found, list) or not all(isinstance(entry, Mapping) for entry in found):
        raise InputError(f"{where}{key} is no list of tables")
    return found


def _finite(value: Any) -> bool:
    return is_number(value) and abs(value) < _LARGEST


def _number(table: Mapping[str, Any], key: str, where: str) -> float:
    if not _finite(table.get(key)):
        said = f"must be a finite number, not {table[key]!r:.40}" if key in table else "is missing"
        raise InputError(f"{where}: {key} {said}")
    return float(table[key])


def _sigma(table: Mapping[str, Any], key: str, where: str) -> float:
    value = _number(table, key, where)
    if value < 0:
        raise InputError(f"{where}: {key} is negative")
    return value


def _vector(table: Mapping[str, Any], key: str, n: int, where: str) -> np.ndarray:
    values = table.get(key)
    if not isinstance(values, list) or len(values) != n or not all(map(_finite, values)):
        raise InputError(f"{where}: {key} must be {n} finite numbers")
    return np.array(values, float)


def _plain(value: Any) -> Any:
    """A value in types of TOML: NumPy arrays as lists, without entries that are None."""
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value
