"""What to know about a fit that was made: one function per warning, each with its code."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from pcalib import units, wording
from pcalib.fitting.evidence import WIDENED
from pcalib.fitting.result import Caution, Code, Fit
from pcalib.fitting.scatter import ENOUGH_RESIDUALS
from pcalib.wording import some_lines

LEFT_OUT = 1.5
"""Warn when rotations that the level leaves out exceed this many σ (RMS): no noise of 20 readings or more does."""
FAR = 6
"""Warn of rows more than this many times as far off as the median row: noise alone reaches 3 in a thousand rows."""
APART, APART_LEAST = 20.0, 1e-3
"""Warn of held-out rows that are so many times as far off as fitted ones (RMS), and more than this [m]: loads and
temperatures that were not fitted leave less."""
LIGHT = 0.5
"""Warn of rows whose robust weight is below this."""
HELD = 0.5
"""Warn of effects of whose prior variance the data leave more than this share."""
STILL = 1e-6
"""[rad or m] Warn of actuators that move by less: files keep commands to a microradian."""
OVERSTATED, UNDERSTATED = 0.7, 1.4
"""Warn when σ of residuals or of replicates differ from the stated σ by such a factor, and by more than chance."""
SURE = 3.3
"""Standard errors that count as more than chance: p = 0.001."""
UNEVEN, RARE = 2.0, 1e-3
"""Warn when the residuals of one component are so many times those of another, and chance does that less often."""
PULLED, LITTLE = 4.0, 0.02
"""Warn of a tracker's target that readings pull so many times as far as noise does, and no less than this share of its
prior σ: a smaller share cannot be told from rounding."""


def cautions(fit: Fit, unsettled: np.ndarray | None = None) -> tuple[Caution, ...]:
    """All warnings about a fit.

    Args:
        unsettled: (n,) bool, fitted rows at which loads and pose do not settle.
    """
    found = [(code, text) for code, check in _CHECKS.items() for text in check(fit)]
    if unsettled is not None:
        lines = some_lines(fit.data.lines[~fit.data.check][unsettled])
        text = (
            f"{lines}: the load pushes a gap shut from either side, so that the model's reading there is uncertain by "
            "that gap"
        )
        found.append((Code.UNSETTLED, text))
    return tuple(Caution(code, text) for code, text in found)


def _rotations_left_out(fit: Fit) -> Iterator[str]:
    if fit.left_out > LEFT_OUT:
        yield (
            f"level {fit.candidate.level} takes parallelograms as perfect: measured rotations are left out, and are "
            f"{wording.deviation(fit.accuracy.rms_rot, 'rad')} RMS off, {fit.left_out:.1f}× their σ"
        )


def _few_directions(fit: Fit) -> Iterator[str]:
    if fit.n_identified < fit.expected:
        yield (f"{fit.n_identified} of {fit.expected} directions are supported by these poses; priors hold the others")


def _priors_widened(fit: Fit) -> Iterator[str]:
    if fit.prior_scale > WIDENED:
        yield (
            f"geometric errors are about {fit.prior_scale:.1f} times the assumed tolerances; the priors were widened "
            "accordingly"
        )


def _tilt_unseen(fit: Fit) -> Iterator[str]:
    fitted = ~fit.data.check
    one_tool = np.ptp(fit.data.tool[fitted], axis=0).max() < 1e-6
    turns = fit.candidate.robot.mechanism.plate_turns
    if turns and one_tool and not fit.data.mask[fitted, 3:].any() and not fit.unknowns.level.perfect:
        yield (
            "position only, with one tool: the plate's tilt is not seen, and other tools are not calibrated; measure "
            "with two more tool lengths or with orientations"
        )


def _effect_unphysical(fit: Fit) -> Iterator[str]:
    for f in fit.candidate.effects:
        for p, value in zip(f.effect.parameters, f.theta, strict=True):
            if not p.low <= value <= p.high:
                shown = f"{wording.figure(value / units.factor(p.unit))} {units.spoken(p.unit)}".strip()
                yield f"{f.effect.name}: {p.name} = {shown} lies outside what is physical"


def _little_weight(fit: Fit) -> Iterator[str]:
    lines = fit.data.lines[fit.weight < LIGHT]
    if len(lines):
        yield f"{_rows(len(lines), 'far from the model')} and of little weight ({some_lines(lines)}); look there"


def _far_rows(fit: Fit) -> Iterator[str]:
    fitted = ~fit.data.check
    length = np.linalg.norm(np.nan_to_num(fit.error[fitted, :3]), axis=1)
    limit = FAR * np.maximum(np.median(length), fit.data.sigma[fitted, 0])
    lines = fit.data.lines[fitted][(length > limit) & (fit.weight[fitted] >= LIGHT)]
    if len(lines):
        yield (
            f"{some_lines(lines)}: more than {FAR} times as far from the model as half of all rows; do command and "
            "measurement belong together? --loss huber gives such rows little weight"
        )


def _far_held_out(fit: Fit) -> Iterator[str]:
    check = fit.data.check
    length = np.linalg.norm(np.nan_to_num(fit.error[check, :3]), axis=1)
    lines = fit.data.lines[check][length > max(APART * fit.accuracy.rms_pos, APART_LEAST)]
    if len(lines):
        yield (
            f"held-out {some_lines(lines)}: more than {APART:.0f} times as far off as the fitted rows; are they of "
            "this robot, in these units? What is expected of landings counts them"
        )


def _other_robot(fit: Fit) -> Iterator[str]:
    named, robot = fit.data.robot_name, fit.candidate.robot.name
    if named and named != robot:
        yield f"the file names robot '{named}', the robot file is of '{robot}'"


def _out_of_reach(fit: Fit) -> Iterator[str]:
    data = fit.data
    lines = data.lines[data.check & data.mask.any(axis=1) & np.isnan(fit.error).all(axis=1)]
    if len(lines):
        yield f"{_rows(len(lines), 'out of the fitted reach, held out')} and not counted ({some_lines(lines)})"


def _at_bound(fit: Fit) -> Iterator[str]:
    unknowns = fit.unknowns
    slack = 1e-6 * unknowns.scale
    for i in np.flatnonzero(np.isfinite(unknowns.lower) | np.isfinite(unknowns.upper)):
        low, value, high = unknowns.lower[i], fit.estimate[i], unknowns.upper[i]
        if value <= low + slack[i] or value >= high - slack[i]:
            unit = unknowns.level.units[unknowns.level.columns.index(unknowns.names[i])]
            yield (
                f"{unknowns.names[i]} lies at its bound, {wording.deviation(float(value), unit, '+')} from nominal: "
                "the data ask for more; fit without the bound, or find out why it cannot be"
            )


def _held_by_prior(fit: Fit) -> Iterator[str]:
    g, e = fit.unknowns.n_geometry, fit.unknowns.n_effects
    share = np.diag(fit.covariance)[g : g + e] / fit.unknowns.prior[g : g + e] ** 2
    for name, part in zip(fit.unknowns.names[g : g + e], share, strict=True):
        if part > HELD:
            yield (
                f"{name}: the data tell little of it, and its prior holds it small; measure where it acts more, or "
                "state a larger usual size of an effect of your own"
            )


def _never_moved(fit: Fit) -> Iterator[str]:
    data = fit.data
    still = np.ptp(data.q[~data.check], axis=0) < STILL
    names = [name for name, rests in zip(data.actuators, still, strict=True) if rests]
    if names and (~data.check).sum() > 1:
        yield f"{', '.join(names)} never moved: what belongs to it is not calibrated; measure poses where it moves"


def _disagrees(ratio: float, dof: float) -> bool:
    """Whether a σ is off by more than chance: the logarithm of a ratio of σ has variance 1/(2·dof)."""
    return bool(np.isfinite(dof) and abs(np.log(ratio)) * np.sqrt(2 * dof) > SURE)


def _sigma_too_large(fit: Fit) -> Iterator[str]:
    for c, what in enumerate(("positions", "rotations")):
        ratio, dof = float(fit.scale.ratio[c]), float(fit.scale.dof[c])
        if fit.data.stated[c] and fit.data.kinds[c] and ratio < OVERSTATED and _disagrees(ratio, dof):
            yield (
                f"residuals of {what} are {ratio:.2g}× their stated σ: is σ stated too large, or are they in another "
                "unit than their columns say?"
            )


def _sigma_too_small(fit: Fit) -> Iterator[str]:
    for c, what in enumerate(("positions", "rotations")):
        ratio = float(fit.scale.replicates[c])
        if fit.data.stated[c] and fit.data.kinds[c] and ratio > UNDERSTATED and not fit.scale.sigma_q:
            yield f"replicates of {what} scatter by {ratio:.2g}× their stated σ: is σ stated too small?"


def _sigma_uneven(fit: Fit) -> Iterator[str]:
    """Components whose residuals differ by more than chance leaves (Bartlett's test of equal variances)."""
    from scipy.special import chdtrc

    if fit.data.readings is not None:  # places of a row then hold what differs in kind
        return
    ratio, dof = fit.scale.components
    frame = "the tracker's" if fit.data.frame == "tracker" else "the base's"
    for c, (axes, about) in enumerate(((("x", "y", "z"), "along"), (("rx", "ry", "rz"), "about"))):
        part = np.arange(3 * c, 3 * c + 3)
        part = part[(ratio[part] > 0) & (dof[part] >= ENOUGH_RESIDUALS / 3)]  # without noise there is nothing to say
        if len(part) < 2 or not fit.data.stated[c]:
            continue
        variance, nu = ratio[part] ** 2, dof[part]
        pooled = float(nu @ variance / nu.sum())
        statistic = float(nu.sum() * np.log(pooled) - nu @ np.log(variance))
        most, least = part[np.argmax(variance)], part[np.argmin(variance)]
        if ratio[most] > UNEVEN * ratio[least] and chdtrc(len(part) - 1, statistic) < RARE:
            a, b = axes[most - 3 * c], axes[least - 3 * c]
            yield (
                f"residuals {about} {frame} {a[-1]} axis are {ratio[most]:.2g}× their stated σ, {about} {b[-1]} "
                f"{ratio[least]:.2g}×: if the instrument errs so, as cameras do in depth, state σ by component "
                f"(# sigma_{a}_{'deg' if c else 'mm'} = …); else the model misses something that shows there"
            )


def _far_from_drawing(fit: Fit) -> Iterator[str]:
    for value in fit.far:
        yield f"far from the drawing: {value.sentence()}"


def _target_away(fit: Fit) -> Iterator[str]:
    """The place of a tracker's target where readings pull it from what the file says by more than chance.

    An estimate that a prior of variance p holds, and that has variance v with the readings, scatters by √(p − v).
    """
    frame, unknowns = fit.candidate.frame, fit.unknowns
    if frame is None or not unknowns.n_frame:
        return
    place = slice(unknowns.n_geometry + unknowns.n_effects + 6, unknowns.n_geometry + unknowns.n_effects + 9)
    prior = frame.sigma_offset**2
    told = np.sqrt(np.maximum(prior - np.diag(fit.covariance)[place], LITTLE**2 * prior))
    pull = float(np.abs(frame.offset / told).max())
    if pull > PULLED:
        yield (
            f"the readings pull the tracker's target from the stated tool point by {pull:.1f}× what noise does: check "
            f"the tool's columns (where it is known less well than to {1e3 * frame.sigma_offset:g} mm, write "
            "'# sigma_target_mm = …' above the header), or something is missing from the model that tilts the plate"
        )


_CHECKS: dict[Code, Callable[[Fit], Iterator[str]]] = {
    Code.ROTATIONS_LEFT_OUT: _rotations_left_out,
    Code.FEW_DIRECTIONS: _few_directions,
    Code.PRIORS_WIDENED: _priors_widened,
    Code.TILT_UNSEEN: _tilt_unseen,
    Code.EFFECT_UNPHYSICAL: _effect_unphysical,
    Code.LITTLE_WEIGHT: _little_weight,
    Code.FAR_ROWS: _far_rows,
    Code.FAR_HELD_OUT: _far_held_out,
    Code.OTHER_ROBOT: _other_robot,
    Code.OUT_OF_REACH: _out_of_reach,
    Code.AT_BOUND: _at_bound,
    Code.HELD_BY_PRIOR: _held_by_prior,
    Code.NEVER_MOVED: _never_moved,
    Code.SIGMA_TOO_LARGE: _sigma_too_large,
    Code.SIGMA_TOO_SMALL: _sigma_too_small,
    Code.SIGMA_UNEVEN: _sigma_uneven,
    Code.FAR_FROM_DRAWING: _far_from_drawing,
    Code.TARGET_AWAY: _target_away,
}


def _rows(n: int, what: str) -> str:
    return f"{n} rows are {what}" if n > 1 else f"1 row is {what}"
