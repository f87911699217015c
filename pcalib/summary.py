"""What a fit says, as stable JSON and as the rows of its table."""

from __future__ import annotations

from typing import Any

import numpy as np

from pcalib import rotation, units, wording
from pcalib.fitting.result import Accuracy, Fit
from pcalib.model import Frame


def micro(value: float) -> float | None:
    """The value in millionths for JSON, which knows no NaN."""
    return float(value * 1e6) if np.isfinite(value) else None


def identified(fit: Fit) -> str:
    """How many combinations of parameters the data identify, in words."""
    count, combinations = fit.unknowns.n_geometry, "combination" + "s" * (fit.n_identified != 1)
    said = f"The {count} parameters of level {fit.candidate.level} show in {fit.n_identified} {combinations}"
    if fit.n_identified >= fit.expected:
        return f"{said}, which is all that such readings tell."
    return f"{said}; at poses that are spread better, such readings would tell {fit.expected}."


def accuracy_json(a: Accuracy) -> dict[str, Any]:
    """The figures of a fit on some rows."""
    return {
        "rms_pos_um": micro(a.rms_pos),
        "max_pos_um": micro(a.max_pos),
        "rms_rot_urad": micro(a.rms_rot),
        "chi2_dof": float(a.chi2_dof) if np.isfinite(a.chi2_dof) else None,
        "rows": a.n_rows,
    }


def fit_json(fit: Fit) -> dict[str, Any]:
    """The JSON of a fit, `pcalib.fit/1`."""
    model = fit.candidate
    mechanism = model.robot.mechanism
    sigma = model.sigma if model.sigma is not None else np.full(len(model.k), np.nan)
    parameters = {
        name: {
            "nominal": float(mechanism.nominal[i]),
            "value": float(model.k[i]),
            "sigma": float(sigma[i]) if np.isfinite(sigma[i]) else None,
            "unit": mechanism.units[i],
        }
        for i, name in enumerate(mechanism.parameters)
    }
    g = fit.unknowns.n_geometry
    if not fit.unknowns.level.raw:
        for j, name in enumerate(fit.unknowns.names[:g]):
            unit = fit.unknowns.level.units[fit.unknowns.level.columns.index(name)]
            parameters[name] = {
                "nominal": 0.0,
                "value": float(fit.estimate[j]),
                "sigma": float(np.sqrt(fit.covariance[j, j])),
                "unit": unit,
            }
    return {
        "schema": "pcalib.fit/1",
        "level": model.level,
        "method": fit.method,
        "status": fit.status,
        "reason": f"{fit.reason}; {fit.remedy}" if fit.reason else None,
        "effects": [
            {
                "effect": f.effect.name,
                "spec": f.spec or f.effect.name,
                "parameters": {
                    p.name: {
                        "value": float(f.theta[i]),
                        "sigma": _at(f.sigma, i),
                        "unit": units.si(p.unit),
                        "shown_in": p.unit,
                    }
                    for i, p in enumerate(f.effect.parameters)
                },
            }
            for f in model.effects
        ],
        "n_identified": fit.n_identified,
        "n_expected": fit.expected,
        **accuracy_json(fit.accuracy),
        "check": accuracy_json(fit.check) if fit.check else None,
        "prior_scale": fit.prior_scale,
        "sigma_scale": {
            "source": fit.scale.source.value,
            "pos": float(fit.scale.ratio[0]) if fit.data.kinds[0] else None,
            "rot": float(fit.scale.ratio[1]) if fit.data.kinds[1] else None,
            "joint_urad": fit.scale.sigma_q * 1e6,
        },
        "iterations": fit.iterations,
        "parameters": parameters,
        "combinations": combinations(fit),
        "frame": _frame(model.frame),
        "unidentifiable": fit.identifiability.sentences(),
        "warnings": [str(warning) for warning in fit.warnings],
        "warning_codes": [warning.code.value for warning in fit.warnings],
    }


def _frame(frame: Frame | None) -> dict[str, Any] | None:
    """Where the tracker stands and how its target sits, SI; null where data are in the base frame."""
    if frame is None:
        return None
    return {
        "translation_si": frame.translation,
        "rotation_si": rotation.log(frame.rotation),
        "target_offset_si": frame.offset,
        "target_turn_si": None if frame.turn is None else rotation.log(frame.turn),
    }


def _at(values: np.ndarray | None, i: int) -> float | None:
    return float(values[i]) if values is not None and np.isfinite(values[i]) else None


def combinations(fit: Fit) -> dict[str, dict[str, Any]]:
    """Values and σ of the kind's merged parameters, e.g. the paper's bp11.x = b11.x − p1.x."""
    mechanism = fit.candidate.robot.mechanism
    g = fit.unknowns.n_geometry
    basis, C = fit.unknowns.basis, fit.covariance[:g, :g]
    out = {}
    for name, mix in mechanism.combinations.items():
        row = np.zeros(len(mechanism.nominal))
        for parameter, factor in mix.items():
            row[mechanism.index(parameter)] = factor
        through = row @ basis
        out[name] = {
            "nominal": float(row @ mechanism.nominal),
            "value": float(row @ fit.candidate.k),
            "sigma": float(np.sqrt(max(through @ C @ through, 0.0))) if g else None,
            "unit": mechanism.units[mechanism.index(next(iter(mix)))],
        }
    return out


def statistics(fit: Fit) -> dict[str, Any]:
    """The figures a model file keeps of its fit."""
    found: dict[str, Any] = {
        "method": fit.method,
        "n_identified": fit.n_identified,
        "prior_scale": fit.prior_scale,
        **accuracy_json(fit.accuracy),
    }
    if fit.check:
        found["check"] = accuracy_json(fit.check)
    return found


def largest_changes(fit: Fit) -> list[tuple[str, str, str, str]]:
    """The six geometric unknowns that changed most in units of their σ: name, change, σ, ratio, as text."""
    g = fit.unknowns.n_geometry
    if g == 0:
        return []
    sigma = np.sqrt(np.diag(fit.covariance)[:g])
    ratio = np.abs(fit.estimate[:g]) / np.where(sigma > 0, sigma, np.inf)
    units = [fit.unknowns.level.units[fit.unknowns.level.columns.index(n)] for n in fit.unknowns.names[:g]]
    rows = []
    for i in np.argsort(-ratio)[:6]:
        if ratio[i] < 3:
            break
        change, doubt = (
            wording.deviation(float(value), units[i], sign) for value, sign in ((fit.estimate[i], "+"), (sigma[i], "-"))
        )
        rows.append((fit.unknowns.names[i], change, doubt, f"{ratio[i]:.1f}"))
    return rows
