"""What a small residual does not prove: values that the data hardly ask for, and a scale that they hardly fix.

Two questions are put to a fit. Which parameters went far from the drawing although holding them there would have cost
little? And where the instrument never saw a direction, how well does the fit know lengths along it? For each doubt the
further reading that would settle it is searched among those a workshop can make.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pcalib import prediction
from pcalib.data.measurement import Measurements
from pcalib.fitting.linearisation import chunks, conditions_of
from pcalib.fitting.result import Fit
from pcalib.mechanics.mechanism import Pose

FAR = 20.0
"""Manufacturing tolerances beyond which a value is not taken on trust."""
CLEAR = 2.0
"""σ of itself from which on a change is one at all."""
HIDDEN = 30.0
"""A change whose trace the other unknowns can make this many times smaller is hidden by them: the square root of the
variance inflation factor."""
ASKED = 1.3
"""Growth of the RMS from which on the data ask for a change: it is then no small error that made it."""
SCALE = 2e-4
"""Relative σ of lengths from which on absolute scale is called weak: 0.1 mm in half a metre."""
OUTERMOST = 1000
"""Poses among which the two that lie farthest apart are searched: all pairs of them are looked at."""


@dataclass(frozen=True)
class Doubt:
    """A result that a small residual does not support."""

    name: str
    """A parameter, or 'scale'."""
    change: float
    """From the drawing [SI]; 0 for scale."""
    sigma: float
    """1σ of it [SI], stated noise and what the fit leaves taken together."""
    unit: str
    """'m', 'rad' or '1'."""
    rms: float
    """[m] RMS position error of the fit, and"""
    rms_held: float
    """[m] what it would be with the parameter at the drawing; that of the fit for scale."""
    remedy: str
    """The reading that would settle it, '' where none of those tried does."""
    sigma_after: float
    """1σ with that reading [SI]."""
    rods_free: bool = True
    """Whether the fit may change the length of rods."""
    geared: bool = False
    """Whether commands are lengths, which a wrong number of motor steps scales."""

    def sentence(self) -> str:
        """The uncertainty in words, and the reading that would reduce it."""
        if self.name == "scale":
            percent = f"±{self.sigma * 100:.2g}"
            text = (
                "absolute scale is weak: lengths along directions that were not measured are uncertain by "
                f"{percent} % (a part of 100 mm by {percent} mm), however small the residual"
                + ("" if self.rods_free else ", and only if the rods are as long as drawn")
                + (": a wrong motion per motor step looks the same" if self.geared else "")
            )
        else:
            asked = self.rms_held > ASKED * self.rms
            text = (
                f"{self.name} lies {_shown(self.change, self.unit, sign=True)} from the drawing "
                f"(±{_shown(self.sigma, self.unit)}), far beyond any tolerance, {'and' if asked else 'yet'} with it "
                f"held there the RMS would be {_length(self.rms_held)} instead of {_length(self.rms)}: "
            ) + (
                "the data do not fit the drawn value, check what was configured"
                if asked
                else "so small an error in the readings or in the model can move it as far"
            )
        if self.remedy:
            text += f"; {self.remedy} would bring it to ±{_shown(self.sigma_after, self.unit)}"
        return text


def _length(value: float) -> str:
    return f"{value * 1e6:.3g} µm" if value < 1e-3 else f"{value * 1e3:.3g} mm"


def _shown(value: float, unit: str, sign: bool = False) -> str:
    plus = "+" if sign else ""
    if unit == "m":
        return f"{value * 1e3:{plus}.3g} mm"
    return f"{np.degrees(value):{plus}.3g}°" if unit == "rad" else f"{value * 100:{plus}.2g} %"


@dataclass(frozen=True)
class _Reading:
    """A further reading: its derivative by the geometric unknowns and its noise."""

    what: str
    rows: np.ndarray
    sigma: float


def doubts(fit: Fit, data: Measurements, most: int = 3) -> list[Doubt]:
    """What of a fit should not be believed for its residual's sake, the gravest first.

    Args:
        fit: a converged fit of
        data: these measurements.
        most: of the parameters; scale comes on top.
    """
    unknowns, g = fit.unknowns, fit.unknowns.n_geometry
    if g == 0:
        return []
    used = ~data.check
    seen = data.mask[used] & ~np.isnan(fit.error[used])
    if fit.unknowns.level.perfect and seen[:, :3].any():
        seen[:, 3:] = False
    chi2 = float(np.sum((fit.error[used][seen] / data.sigma[used][seen]) ** 2))
    # The covariance holds the noise that the data support, over the stated one by this factor.
    inflate = float(np.sqrt(np.mean(fit.scale.ratio[np.array(fit.data.kinds)] ** 2)))
    covariance = fit.covariance[:g, :g]
    units = [unknowns.level.units[unknowns.level.columns.index(name)] for name in unknowns.names[:g]]
    own = _beside_rigid_motions(fit)
    change = own @ fit.estimate[:g]
    sigma = np.sqrt(np.einsum("ij,jk,ik->i", own, covariance, own))
    far = np.abs(change) / unknowns.scale[:g]
    with np.errstate(divide="ignore", invalid="ignore"):
        growth = np.sqrt(1 + (change / sigma * inflate) ** 2 / max(chi2, 1e-30))
    # Zeros of encoders, endstops and legs are set and not made, and may lie anywhere.
    made = ~fit.candidate.robot.mechanism.is_setting(unknowns.level)[unknowns.keep]
    fitted, square = data.take(used), np.zeros(g)
    for r, S, _, _ in _geometry(fit, fitted):
        square += np.sum((S[seen[r]] / fitted.sigma[r][seen[r]][:, None]) ** 2, axis=0)
    trace = np.sqrt(square)
    hidden = sigma / inflate * trace
    clear = np.abs(change) > CLEAR * sigma
    suspects = [j for j in np.argsort(-far * hidden) if made[j] and clear[j] and far[j] > FAR and hidden[j] > HIDDEN]
    wanted = [(unknowns.names[j], own[j], float(change[j]), units[j], growth[j]) for j in suspects[:most]]
    scale = _scale(fit, data)
    if scale is not None and np.sqrt(scale @ covariance @ scale) > SCALE:
        wanted.append(("scale", scale, 0.0, "1", 1.0))
    if not wanted:
        return []
    readings = _readings(fit, data)
    mechanism = fit.candidate.robot.mechanism
    rods_free = bool(unknowns.basis[mechanism.rod_lengths].any())
    out = []
    for name, direction, change, unit, ratio in wanted:
        now = float(np.sqrt(direction @ covariance @ direction))
        after, best = min(
            ((_after(covariance, direction, reading), reading.what) for reading in readings), default=(now, "")
        )
        helps = after < 0.5 * now
        out.append(
            Doubt(
                name, change, now, unit, fit.accuracy.rms_pos, fit.accuracy.rms_pos * float(ratio),
                best if helps else "", after if helps else now, rods_free,
                mechanism.actuator_dimension == "length",
            )
        )  # fmt: skip
    return out


def _beside_rigid_motions(fit: Fit) -> np.ndarray:
    """(g, g) projection of the unknowns off motions of base or plate as a whole, which are the frames' affair.

    Where the raw parameters are fitted to poses in an instrument's frames, those frames are in the result; a drawing
    can be compared with it only after base and plate have been laid upon each other.
    """
    unknowns = fit.unknowns
    g = unknowns.n_geometry
    if not unknowns.level.raw:
        return np.eye(g)
    scaled = fit.candidate.robot.mechanism.rigid_motions[unknowns.keep] / unknowns.scale[:g, None]
    U, s, _ = np.linalg.svd(scaled, full_matrices=False)
    U = U[:, s > 1e-9 * s[0]]
    off = np.eye(g) - U @ U.T
    return off * unknowns.scale[:g, None] / unknowns.scale[None, :g]


def _after(covariance: np.ndarray, direction: np.ndarray, reading: _Reading) -> float:
    """σ of a direction once a reading is added (the Kalman update)."""
    H = reading.rows / reading.sigma
    if len(H) > H.shape[1]:
        H = np.asarray(np.linalg.qr(H, mode="r"))  # HᵀH is all that readings of many rows say
    through = covariance @ direction
    innovation = np.eye(len(H)) + H @ covariance @ H.T
    gain = H @ through
    return float(np.sqrt(max(direction @ through - gain @ np.linalg.solve(innovation, gain), 0.0)))


def _geometry(fit: Fit, data: Measurements) -> Iterator[tuple[slice, np.ndarray, np.ndarray, np.ndarray]]:
    """Chunk by chunk: its slice of the rows, the derivative of readings (n, 6, g) by the geometric unknowns, predicted
    positions (n, 3), and which rows exist."""
    model = fit.candidate
    for r in chunks(len(data)):
        part = data.take(r)
        p = prediction.predict(model, part.q, conditions_of(part))
        at, JX = prediction.closure_of(model, p)
        S = prediction.geometry_columns(model, p, at, JX, fit.unknowns.basis)
        yield r, S, p.position, p.status == "ok"


def _scale(fit: Fit, data: Measurements) -> np.ndarray | None:
    """Derivative of the lengths' scale along directions that no row measures, (g,); None where all are measured."""
    unseen = [c for c in range(3) if c in fit.candidate.robot.mechanism.plate_dofs and not data.mask[:, c].any()]
    if not unseen or not data.mask[:, :3].any():
        return None
    x, ok = _positions(fit, data)
    x = x[:, unseen] - x[ok][:, unseen].mean(axis=0)
    along = np.zeros(fit.unknowns.n_geometry)
    for r, S, _, here in _geometry(fit, data):
        along += np.einsum("nc,ncg->g", x[r][here], S[here][:, unseen])
    return along / np.sum(x[ok] ** 2)


def _positions(fit: Fit, data: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Predicted positions (N, 3), and which rows exist (N,)."""
    p = prediction.predict(fit.candidate, data.q, conditions_of(data))
    return p.position, p.status == "ok"


def _readings(fit: Fit, data: Measurements) -> list[_Reading]:
    """What a workshop can measure beside these data."""
    model, unknowns = fit.candidate, fit.unknowns
    mechanism = model.robot.mechanism
    found = []
    if mechanism.is_rod.any():
        first = int(np.flatnonzero(mechanism.is_rod)[0])
        row = unknowns.basis[mechanism.actuation.length[first]][None]
        found.append(_Reading(f"the length of rod {mechanism.rods[first]}, joint to joint, to 0.05 mm,", row, 5e-5))
    unseen = [c for c in range(3) if c in mechanism.plate_dofs and not data.mask[:, c].any()]
    if unseen:
        x, ok = _positions(fit, data)
        ends = np.array(_farthest(x[:, unseen], ok))
        _, S, x, _ = next(_geometry(fit, data.take(ends)))
        away = x[1, unseen] - x[0, unseen]
        span = float(np.linalg.norm(away))
        row = (away / span) @ (S[1, unseen] - S[0, unseen])
        axes = " and ".join("xyz"[c] for c in unseen)
        found.append(
            _Reading(f"one known distance of {span * 1e3:.0f} mm in {axes} (caliper, to 0.1 mm)", row[None], 1e-4)
        )
        raised = _raised(fit, data, 0.5 * span)
        if raised is not None:
            heights, rows = raised
            what = f"the same heights {heights * 1e3:.0f} mm higher (gauge block, to 0.02 mm)"
            found.append(_Reading(what, rows, 2e-5))
    elif not data.mask[:, 3:].any():
        ok = _positions(fit, data)[1]
        _, S, _, _ = next(_geometry(fit, data.take(np.flatnonzero(ok)[:10])))
        rows = S[:, 3:].reshape(-1, S.shape[-1])
        found.append(_Reading("orientations at ten of these poses, to 0.01°,", rows, float(np.radians(0.01))))
    return found


def _farthest(x: np.ndarray, ok: np.ndarray) -> tuple[int, int]:
    """The two poses that lie farthest apart; of very many, among those that are farthest from the middle."""
    rows = np.flatnonzero(ok)
    if len(rows) > OUTERMOST:
        rows = np.sort(rows[np.argsort(-np.linalg.norm(x[rows] - x[rows].mean(axis=0), axis=1))[:OUTERMOST]])
    d = np.linalg.norm(x[rows][:, None] - x[rows][None], axis=-1)
    a, b = np.unravel_index(int(np.argmax(d)), d.shape)
    return int(rows[a]), int(rows[b])


def _raised(fit: Fit, data: Measurements, height: float) -> tuple[float, np.ndarray] | None:
    """Heights of the same points further up: the height, and the derivative of each (n, g)."""
    from pcalib.mechanics import kinematics

    model = fit.candidate
    mechanism, w = model.robot.mechanism, model.robot.workspace
    pose: Pose = kinematics.forward(mechanism, model.k, data.q).pose
    height = min(height, max(w.z_max - float(pose.x[:, 2].max()), 0.0))
    if height < 5e-3:
        return None
    above = kinematics.inverse(mechanism, model.k, pose.x + [0.0, 0.0, height], pose.R)
    there = replace(data, q=above.q).take(above.ok)
    return height, np.concatenate([S[ok][:, 2] for _, S, _, ok in _geometry(fit, there)])


def json(found: Sequence[Doubt]) -> list[dict[str, Any]]:
    """The doubts with stable keys, in SI."""
    return [
        {
            "parameter": d.name, "change": d.change, "sigma": d.sigma, "unit": d.unit, "rms_um": d.rms * 1e6,
            "rms_held_um": d.rms_held * 1e6, "remedy": d.remedy or None, "sigma_after": d.sigma_after,
            "text": d.sentence(),
        }
        for d in found
    ]  # fmt: skip
