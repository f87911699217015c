"""Diagnoses, comparisons and steps as stable JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from pcalib import summary, units
from pcalib.diagnosis.advice import advice
from pcalib.diagnosis.compare import Comparison
from pcalib.diagnosis.diagnose import Diagnosis, Finding
from pcalib.diagnosis.evidence import Evidence
from pcalib.diagnosis.held_out import Change
from pcalib.diagnosis.patterns import Cell
from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.steps import Step
from pcalib.diagnosis.telling import one_per_effect, sentence
from pcalib.fitting.noise_level import NoiseLevel


def noise_json(level: NoiseLevel) -> dict[str, Any]:
    """The noise part of all JSON."""
    return {
        "verified": level.verified,
        "source": level.source,
        "sigma_pos_um": summary.micro(level.sigma_pos),
        "sigma_rot_urad": summary.micro(level.sigma_rot),
        "sigma_joint_urad": summary.micro(level.sigma_q),
        "encoder_steps_urad": summary.micro(level.steps),
        "ratio_to_stated": [float(r) for r in level.ratio],
        "dof": [float(d) if np.isfinite(d) else None for d in level.dof],
    }


def _change_json(change: Change | None) -> dict[str, Any] | None:
    if change is None:
        return None
    return {
        "chi2_before": change.before, "chi2_after": change.after, "readings": change.readings, "t": change.t,
        "confirmed": change.confirmed,
    }  # fmt: skip


def _cell_json(cell: Cell, made: Problem) -> dict[str, Any]:
    out = {"channel": cell.channel, "variable": cell.variable, "p": cell.p, "s": cell.s, "columns": cell.d,
           "p_left": cell.p_left, "s_left": cell.s_left}  # fmt: skip
    if cell.found is not None and cell.theta is not None:
        out["break"] = {
            "shape": cell.found.shape, "member": cell.found.member if cell.found.member >= 0 else None,
            "line": int(made.data.lines[cell.found.row]), "size": cell.theta.tolist(),
        }  # fmt: skip
    return out


def diagnosis_json(found: Diagnosis) -> dict[str, Any]:
    """`pcalib.diagnosis/1`: one entry per effect, in the variant that stands in an adequate set, else the simplest."""
    made = found.problem
    return {
        "schema": "pcalib.diagnosis/1",
        "verdict": found.verdict,
        "sentence": sentence(found),
        "round": found.round,
        "established": list(found.established),
        "adequate": [list(e.names) for e in found.sets if e.names],
        "explanations": [
            {
                "effects": list(e.names),
                "specs": list(e.specs),
                "bic": e.bic,
                "words": e.words(),
                "held_out_chi2": None if e.held_out is None else [e.held_out.before, e.held_out.after],
                "held_out": _change_json(e.held_out),
                "doubts": [doubt.name.lower() for doubt in e.doubts],
                "unconfirmed": list(e.unconfirmed),
                "plausible": not e.implausible,
                "implausible": [f"{odd.effect}: {odd.words}" for odd in e.implausible],
            }
            for e in found.sets
            if e.names
        ],
        "nearly": _nearly_json(found),
        "refuted": list(found.refuted),
        "candidates": [_candidate_json(f) for f in one_per_effect(found)],
        "unavailable": [{"effect": u.name, "why": u.why} for u in found.unavailable],
        "noise": noise_json(found.noise),
        "misfit": {"chi2_dof": found.misfit.chi2_dof, "p": found.misfit.p, "dof": found.misfit.dof},
        "as_given": {
            "times_noise": found.given.fit,
            "times_noise_check": found.given.check,
            "p_refit": found.given.refit_p,
            "p_check": found.given.check_p,
            "p_law": found.given.law_p,
            "times_stated": found.given.stated,
            "against": list(found.given.against),
        },
        "rows": {"fit": made.of, "looked_at": len(made.given)},
        "outliers": [int(made.given.lines[i]) for i in made.outliers.rows],
        "heatmap": [_cell_json(c, made) for c in found.cells],
        "next": advice(found),
    }


def _nearly_json(found: Diagnosis) -> dict[str, Any] | None:
    if found.nearly is None:
        return None
    cell = None if found.nearly.where is None else found.problem.patterns[found.nearly.where]
    return {
        "effects": list(found.nearly.explanation.names),
        "specs": list(found.nearly.explanation.specs),
        "taken": found.nearly.taken,
        "held_out": _change_json(found.nearly.explanation.held_out),
        "left": {"s": found.nearly.left, "where": cell and [cell.channel, cell.variable]},
    }


def _candidate_json(f: Finding) -> dict[str, Any]:
    effect = f.candidate.effect
    parameters = {}
    if effect is not None:
        for i, p in enumerate(effect.parameters):
            parameters[p.name] = {
                "value": float(f.theta[i]),
                "sigma": float(f.sigma[i]) if np.isfinite(f.sigma[i]) else None,
                "smallest_seen": float(f.smallest_seen[i]) if np.isfinite(f.smallest_seen[i]) else None,
                "unit": units.si(p.unit),
                "shown_in": p.unit,
            }
    return {
        "effect": f.candidate.name,
        "spec": f.candidate.spec,
        "kappa": f.kappa,
        "s": f.s,
        "p": f.p,
        "adequate": f.adequate,
        "parameters": parameters,
        "note": f.why,
    }


def comparison_json(c: Comparison) -> dict[str, Any]:
    """`pcalib.comparison/1`."""
    return {
        "schema": "pcalib.comparison/1",
        "fit": summary.accuracy_json(c.fit),
        "check": summary.accuracy_json(c.check) if c.check else None,
        "times_noise": c.times_noise[0],
        "times_noise_check": c.times_noise[1],
        "noise": noise_json(c.noise),
        "misfit": {"chi2_dof": c.misfit.chi2_dof, "p": c.misfit.p, "dof": c.misfit.dof},
        "rows": {"fit": c.problem.of, "looked_at": len(c.problem.given)},
        "worst": [
            {
                "line": w.line,
                "error_pos_um": summary.micro(float(np.linalg.norm(w.error[:3]))),
                "error_rot_urad": summary.micro(float(np.linalg.norm(w.error[3:]))),
                "times_noise": w.times_noise,
                "set": "check" if w.check else "fit",
                "outlier": w.outlier,
            }
            for w in c.worst
        ],
        "heatmap": [_cell_json(cell, c.problem) for cell in c.cells],
    }


def step_json(step: Step) -> dict[str, Any]:
    """`pcalib.add/1`, of adding and of dropping."""
    return {
        "schema": "pcalib.add/1",
        "action": step.action,
        "effect": step.spec,
        "before": summary.fit_json(step.before),
        "after": summary.fit_json(step.after),
        "held_out": _change_json(step.held),
        "moved": [{"parameter": n, "change_si": c, "sigmas": t} for n, c, t in step.moved()],
    }


def evidence_json(e: Evidence) -> dict[str, Any]:
    """`pcalib.explanation/1`."""
    return {
        "schema": "pcalib.explanation/1",
        "effect": e.candidate.name,
        "spec": e.candidate.spec,
        "words": e.candidate.hypothesis.sentence(e.finding.theta),
        **{k: v for k, v in _candidate_json(e.finding).items() if k in ("kappa", "s", "p", "adequate", "parameters")},
        "in_physical_range": e.in_range,
        "rest": {"p": e.rest_p, "hottest": e.rest},
        "rivals": list(e.rivals),
        "held_out_times_noise": e.held_out and [e.held_out.times_before, e.held_out.times_after],
        "held_out": _change_json(e.held_out),
        "before": summary.fit_json(e.before) if e.before else None,
        "after": summary.fit_json(e.after) if e.after else None,
        "verdict": e.diagnosis.verdict,
    }
