"""Changes between sessions in words and as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from pcalib.changes.results import Changed, Changes, ChangeSet, Verdict
from pcalib.diagnosis.hypothesis import Kind
from pcalib.diagnosis.patterns import spoken
from pcalib.diagnosis.telling import p_text
from pcalib.wording import angle, small

HOT = 0.05
"""Corrected p below which a cell of the map is named."""
SHOWN = 5
"""Alternatives that are listed one by one."""
TABLE = ("part", "change", "noise units", "p")
"""Header of the table of parts."""


def sentence(found: Changes) -> str:
    """The verdict in one sentence: whether something changed, what, and by how much."""
    if found.verdict is Verdict.NOTHING:
        return (
            "Nothing changed: the model predicts this session within the noise and its own uncertainty "
            f"(p {p_text(found.p)})."
        )
    if found.verdict is Verdict.UNEXPLAINED:
        hot = [f"{spoken(c.channel, c.sliding)} by {c.variable}" for c in found.cells if c.p < HOT][:2]
        where = f" It shows in {'; '.join(hot)}." if hot else ""
        return (
            f"Something changed, and no part, pair of parts or effect explains it (p {p_text(found.p)}).{where} "
            "Recalibrate from a full set of poses."
        )
    best = in_words(found.sets[0])
    if found.verdict is Verdict.ESTABLISHED:
        return f"Something changed: {best}."
    others = [" and ".join(m.candidate.hypothesis.words for m in e.members) for e in found.sets[1:3]]
    more = f" (and {len(found.sets) - 3} more)" if len(found.sets) > 3 else ""
    return f"Something changed: {best}; or {'; or '.join(others)}{more}. These poses cannot tell which."


def in_words(explained: ChangeSet) -> str:
    """What changed and by how much."""
    said = []
    for m in explained.members:
        said.append(f"{m.candidate.hypothesis.words}{', by ' if m.candidate.effect is None else ': '}{amount(m)}")
    return "; and ".join(said)


def amount(member: Changed) -> str:
    """The size of a change with its σ, and its direction where it has one."""
    effect = member.candidate.effect
    if effect is not None and member.before is not None:
        return f"{effect.describe(member.before + member.theta)}, before {effect.describe(member.before)}"
    if effect is not None:
        return effect.describe(member.theta)
    units = member.candidate.hypothesis.units
    parts = []
    for unit in dict.fromkeys(units):
        of = np.array([u == unit for u in units])
        theta, sigma = member.theta[of], member.sigma[of]
        if len(theta) == 1:
            parts.append(f"{_value(theta[0], unit, '+')} ± {_value(sigma[0], unit)}")
        elif np.isfinite(sigma).all():
            size = float(np.linalg.norm(theta))
            along = theta / size if size else theta
            doubt = float(np.sqrt(np.sum((along * sigma) ** 2)))
            parts.append(f"{_value(size, unit)} ± {_value(doubt, unit)}{_way(along) if len(theta) == 3 else ''}")
        else:
            parts.append(f"{_value(float(np.linalg.norm(theta)), unit)} as far as these poses see it")
    return ", ".join(parts)


def _way(along: np.ndarray) -> str:
    """Direction of a vector, where it lies within 25° of an axis of its frame."""
    i = int(np.argmax(np.abs(along)))
    return f" along {'+' if along[i] > 0 else '−'}{'xyz'[i]}" if abs(along[i]) > np.cos(np.radians(25)) else ""


def _value(value: float, unit: str, sign: str = "") -> str:
    if not np.isfinite(value):
        return "unknown"
    plus = "+" if sign and value > 0 else ""
    if unit == "m":
        return plus + small(float(value), "m")
    return plus + (angle(float(value)) if unit == "rad" else f"{1e6 * value:.3g} ppm")


def lines(found: Changes) -> list[str]:
    """Details of the verdict, one sentence each: the measuring frame, the misfit, the smallest change that is found."""
    out = [f"Or {in_words(e)}." for e in found.sets[1:SHOWN]]
    if len(found.frame):
        shift, turn = float(np.linalg.norm(found.frame[:3])), float(np.linalg.norm(found.frame[3:6]))
        moved = f"{small(shift, 'm')} and {angle(turn)}"
        out.append(f"The measuring frame moved by {moved}, as it may: the instrument was set up anew.")
    if (misfit := found.session.left.misfit) > 1:
        out.append(
            f"Rows of its own session that the model was not fitted to lie {np.sqrt(misfit):.2g} times the noise off; "
            "a difference as small as that does not count as a change."
        )
    seen = smallest(found)
    if seen:
        out.append(f"Smallest change that would have been seen: {', '.join(f'{w} {v}' for w, v in seen)}.")
    return out


def smallest(found: Changes) -> list[tuple[str, str]]:
    """Kind of part, and the smallest change that would have been seen: the median over the parts of this kind."""
    groups: dict[str, list[tuple[float, str]]] = {}
    for f in found.findings:
        h = f.candidate.hypothesis
        if h.kind is not Kind.PART or f.slip is not None or len(f.theta) > 3:
            continue
        of = "zeros" if h.name.endswith(".zero") else "scales" if h.name.endswith(".scale") else None
        of = of or ("rods" if len(f.theta) == 1 else "ball joints" if len(f.theta) == 3 else None)
        if of is not None:
            groups.setdefault(of, []).append((float(np.max(f.smallest)), h.units[0]))
    out = []
    for of, values in groups.items():
        typical = float(np.median([v for v, _ in values]))
        if np.isfinite(typical):
            out.append((of, _value(typical, values[0][1])))
    return out


def rows(found: Changes) -> list[tuple[str, str, str, str]]:
    """The hottest findings, a row each."""
    hot = [f for f in found.findings if f.p < HOT][:8]
    return [(f.name, amount(f), f"{f.s:.1f}", p_text(f.p)) for f in hot]


def as_json(found: Changes) -> dict[str, Any]:
    """`pcalib.changes/1`."""
    left = found.session.left
    slip = next((m.slip for e in found.sets[:1] for m in e.members if m.slip is not None), None)
    return {
        "schema": "pcalib.changes/1",
        "verdict": found.verdict.value,
        "sentence": sentence(found),
        "established": list(found.established),
        "adequate": [list(e.names) for e in found.sets],
        "parts": [
            {
                "part": f.name,
                "parameters": {
                    name: {"change_si": float(v), "sigma_si": float(s), "smallest_seen_si": float(m)}
                    for name, v, s, m in zip(_names(f), f.theta, f.sigma, f.smallest, strict=True)
                },
                "s": f.s,
                "p": f.p,
                "smallest_seen": float(np.max(f.smallest)),
            }
            for f in found.findings
            if f.slip is None
        ],
        "frame": found.frame,
        "slip": None if slip is None else {"row": slip.row + 1, "part": slip.hypothesis.name},
        "noise": {
            "ratio_to_stated": left.ratio,
            "sigma_q_si": left.sigma_q,
            "misfit": left.misfit,
            "dof": left.dof if np.isfinite(left.dof) else None,
        },
        "misfit": {"chi2_dof": found.chi2_dof, "p": found.p},
        "heatmap": [
            {"channel": c.channel, "variable": c.variable, "p": c.p, "s": c.s, "columns": c.d} for c in found.cells
        ],
    }


def _names(f: Changed) -> list[str]:
    if f.candidate.effect is not None:
        return [p.name for p in f.candidate.effect.parameters]
    n = len(f.theta)
    return ["value"] if n == 1 else list("xyz") if n == 3 else [str(i + 1) for i in range(n)]
