"""What a diagnosis says in plain sentences, and the rows of its tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcalib import effects
from pcalib.diagnosis import rounds
from pcalib.diagnosis.adequacy import SEARCH
from pcalib.diagnosis.advice import does_as_geometry, fitted_to
from pcalib.diagnosis.compare import Comparison
from pcalib.diagnosis.diagnose import Diagnosis, Finding, Why
from pcalib.diagnosis.evidence import Evidence
from pcalib.diagnosis.held_out import Change
from pcalib.diagnosis.hypothesis import Kind
from pcalib.diagnosis.patterns import HOT, Cell, spoken
from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.steps import Step
from pcalib.diagnosis.verdict import Against, Doubt, Explanation, Nearly
from pcalib.fitting.identification import Accuracy, Fit
from pcalib.wording import angle, capital, clipped, deviation, figure, size, small

MORE = 1.25
"""Two figures in units of the noise that differ by this factor do not say the same."""


def one_per_effect(found: Diagnosis) -> list[Finding]:
    """One finding per effect or level, hottest first: the variant in the best explanation, else the simplest as hot."""
    chosen = {h.name: h.spec for e in reversed(found.sets) for h in e.members}
    out: dict[str, Finding] = {}
    for f in found.findings:
        name = f.candidate.name
        if name not in out:
            mine = [x for x in found.findings if x.candidate.name == name]
            if name in chosen:
                out[name] = next((x for x in mine if x.candidate.spec == chosen[name]), f)
            else:
                out[name] = min(mine, key=lambda x: (x.p > 4 * f.p, len(x.candidate.scale)))
    return sorted(out.values(), key=lambda f: (f.p, -f.s))


def sentence(found: Diagnosis) -> str:
    """The verdict in plain words; it begins with the model as it stands where that does not fit."""
    return " ".join(part for part in (_as_given(found), _verdict(found)) if part)


def _as_given(found: Diagnosis) -> str:
    """What speaks against the model as it stands; empty where nothing does, or where the verdict says the same."""
    given, against = found.given, found.given.against
    if Against.STALE in against:
        held = "" if given.check is None else f", held-out rows {figure(given.check, 2)} times"
        if len(found.problem.outliers.rows):
            why, do = ": rows that are far from everything have bent it", "Refit it with --loss huber"
        else:
            why, do = _bounds(found), "Refit it" if fitted_to(found.problem) else "Refit it, or find what changed"
        times = figure(given.fit, 2)
        return f"The model does not fit these data as it stands: {times} times the noise{held}{why}. {do}."
    if Against.HELD_OUT in against and found.verdict != "established":
        assert given.check is not None
        return f"The model does not fit the held-out rows: {figure(given.check, 2)} times the noise.{_beyond(found)}"
    if Against.STATED in against and not found.sets and not hot_cells(found.cells):
        times = figure(given.stated, 2)
        return f"What is left over is {times} times the stated noise, and no replicates show a larger one."
    return ""


def _bounds(found: Diagnosis) -> str:
    """Bounds that may have prevented a better fit, as a clause."""
    bounds = found.problem.model.options.bounds if fitted_to(found.problem) else {}
    return f": the bound on {' and '.join(bounds)} may prevent a better fit" if bounds else ""


def _beyond(found: Diagnosis) -> str:
    """Which conditions held-out rows have that rows to fit have not."""
    fit, check = found.problem.given, found.checked
    if check is None or not len(check):
        return ""
    names = []
    pairs = [("payload", fit.payload, check.payload)]
    pairs += [(spoken_column(c), v, check.columns[c]) for c, v in fit.columns.items() if c in check.columns]
    pairs += [(f"tool {a}", fit.tool[:, i], check.tool[:, i]) for i, a in enumerate("xyz")]
    for name, a, b in pairs:
        spread = max(float(np.ptp(a)), 1e-9 * float(np.max(np.abs(b), initial=1.0)))
        if np.mean((b > a.max() + 0.5 * spread) | (b < a.min() - 0.5 * spread)) > 0.2 and name not in names:
            names.append(name)
    if not names:
        return ""
    return f" They differ from the rows to fit in {' and '.join(names[:3])}: what acts there is missing."


def spoken_column(name: str) -> str:
    """A column of the data in words."""
    return {"temp": "temperature"}.get(name, name.replace("temp_", "temperature of "))


def _called(option: Explanation, beside: Sequence[str]) -> str:
    """An explanation by the names of effects and levels and the words for parts, those beside left out."""
    said = [h.words if h.kind is Kind.PART else h.name for h in option.members if h.name not in beside]
    return " with ".join(said)


def _verdict(found: Diagnosis) -> str:
    if found.verdict == "nothing_missing":
        return "Nothing is missing: what the model leaves over looks like noise."
    if found.verdict == "established":
        return f"What is missing: {found.sets[0].words()}."
    if found.verdict == "ambiguous":
        if len(found.sets) == 1 and found.established and found.sets[0].unconfirmed:
            best = found.sets[0]
            sure = "; ".join(h.sentence(theta) for h, theta in best.pairs if h.name in found.established)
            rest = "; ".join(h.sentence(theta) for h, theta in best.pairs if h.name not in found.established)
            return f"What is missing: {sure}. Perhaps also {rest}, which held-out poses do not confirm."
        if len(found.sets) == 1:
            return f"Perhaps {found.sets[0].words()}; {', and '.join(_doubts(found.sets[0]))}."
        options = _or([_called(e, found.established) for e in found.sets])
        sure = f"{' and '.join(found.established)} in any case, and with it " if found.established else ""
        return f"Something is missing: {sure}{options}. These poses cannot tell which."
    if found.events:
        event, *others = (broken(found.problem, one) for one in found.events)
        rest = "with it, what is left looks like noise"
        if others:
            rest = f"or {others[0]}; these rows cannot tell which, and with either what is left looks like noise"
        return f"Something happened while measuring. {capital(event)}; {rest}."
    if Against.LAW in found.given.against:
        p = p_text(found.given.law_p)
        return f"Something is missing: no listed effect shows it, a law outside the library does (p {p})."
    odd, hot = found.problem.outliers, hot_cells(found.cells)
    if odd.too_many and not hot:
        what = "what the others leave over looks like noise" if not odd.kept else "too many to set them aside"
        return f"{len(odd.rows)} of {len(found.problem.given)} rows are far from everything: look at them; {what}."
    if found.given.against and not hot:
        if Against.HELD_OUT in found.given.against and Against.STALE not in found.given.against:
            return "Something is missing that the rows to fit do not show."
        return "" if Against.STALE in found.given.against else "Something is missing, or σ is stated too small."
    if found.nearly is not None:
        return _nearly(found, found.nearly)
    return f"Something is missing, and no effect of the library explains it. {_where(found)}"


def _nearly(found: Diagnosis, nearly: Nearly) -> str:
    """Effects that explain nearly everything, what they do for held-out poses, and where the rest shows."""
    names = " with ".join(nearly.explanation.specs)
    change = nearly.explanation.held_out
    held = ""
    if change is not None:
        held = f" (held-out poses: from {figure(change.times_before)} to {figure(change.times_after)} times the noise)"
    much = "nearly all of it" if nearly.taken > 0.985 else f"{100 * nearly.taken:.0f} % of it"
    said = f"Something is missing. {names} explains {much}{held}; a small part remains."
    if nearly.where is None:
        return said
    cell = found.problem.patterns[nearly.where]
    shown = next(c for c in found.cells if (c.channel, c.variable) == (cell.channel, cell.variable))
    return f"{said} It is {figure(nearly.left, 2)} noise units, and shows best in {place(shown)}."


def _doubts(best: Explanation) -> list[str]:
    """Why an explanation is not established; sizes that robots do not have are said in figures."""
    return [*best.doubts, *(f"its {odd.words}: look at that part, or it is something else" for odd in best.implausible)]


def _or(options: Sequence[str]) -> str:
    shown = list(options) if len(options) <= 6 else [*options[:5], f"one of {len(options) - 5} more"]
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + " or " + shown[-1]


def _where(found: Diagnosis) -> str:
    hot = hot_cells(found.cells)[:3]
    repeats = ""
    if found.noise.repeatable:
        sliding = found.problem.model.robot.mechanism.actuator_dimension == "length"
        errors = small(found.noise.repeatable, "m" if sliding else "rad")
        repeats = (
            f"It repeats like errors of the {spoken('actuator', sliding)} of {errors}, e.g. of a coarse encoder. "
        )
    if not hot:
        return f"{repeats}It follows none of the recorded variables."
    return repeats + "It shows in " + "; ".join(broken(found.problem, c) for c in hot) + "."


def place(cell: Cell) -> str:
    """A cell in words."""
    return f"{channel(cell)} by {variable(cell)}"


def broken(made: Problem, cell: Cell) -> str:
    """A step or a change of slope with its motor, row and size; the cell's words for any other."""
    if cell.found is None or cell.theta is None:
        return place(cell)
    mechanism = made.model.robot.mechanism
    line = made.data.lines[cell.found.row]
    if cell.found.channel == "actuator":
        what = f"motor {mechanism.actuators[cell.found.member]}"
        by = deviation(float(cell.theta[0]), "m" if cell.sliding else "rad", "+")
    else:
        shift, turn = (float(np.linalg.norm(part)) for part in (cell.theta[:3], cell.theta[3:]))
        what, by = "the plate as a whole", f"{size(shift)} and {angle(turn)} about the base"
    if cell.found.shape == "step":
        return f"{what}: it steps by {by} before line {line}"
    return f"{what}: from line {line} on it moves evenly with time, by {by} to the end"


def details(found: Diagnosis) -> list[str]:
    """What to know beside the verdict, one sentence each."""
    out = [noise_sentence(found.problem), *looked_at(found.problem), *far_rows(found.problem), *_round(found)]
    asked = [(_called(e, ()), e.held_out) for e in found.sets if e.held_out is not None]
    for name, change in asked:
        out.append(f"Held-out poses{f' with {name}' * (len(asked) > 1)}: {_held_out(change)}.")
    if found.sets and found.events:
        out.append(f"It may as well be an event: {broken(found.problem, found.events[0])}.")
    if len(found.sets) > 1:
        out += [f"{odd.effect}: its {odd.words}." for e in found.sets for odd in e.implausible]
    if found.verdict == "ambiguous" and len(found.sets) > 1:
        if Doubt.SMALL in found.sets[0].doubts:
            out.append(f"Held-out rows ask for it; {Doubt.SMALL}.")
        out.append("Until more is measured, any of them corrects poses like these equally well.")
    if not found.noise.verified and found.verdict in ("established", "ambiguous", "unexplained"):
        out.append("Without replicates this is a ranking rather than a proof.")
    return out


def _round(found: Diagnosis) -> list[str]:
    """Which round of measuring this is, and what that changes."""
    if found.round == 1:
        return []
    now = rounds.share(found.round) * SEARCH
    return [
        f"Round {found.round} of measuring and diagnosing again: the limit of p for a finding is now "
        f"{figure(now * 100, 2)} %, instead of {SEARCH:.0%} in round 1, so that all rounds together raise few "
        "false alarms."
    ]


def _held_out(change: Change) -> str:
    """What held-out rows say of an explanation."""
    said = "they confirm it" if change.confirmed else "they speak against it" if change.refuted else "within chance"
    return f"χ² {change.before:.0f} → {change.after:.0f} of {change.readings} readings, {said}"


def noise_sentence(made: Problem) -> str:
    """The noise level and where it comes from, in this robot's units."""
    angles = made.model.robot.mechanism.actuator_dimension == "angle"
    return made.noise.sentence("µrad" if angles else "µm")


def looked_at(made: Problem) -> list[str]:
    """How many rows stand for all, where a file has more than are looked at."""
    if len(made.given) == made.of:
        return []
    return [
        f"What is missing was looked for in {len(made.given)} of the {made.of} rows to fit: in stretches spread evenly "
        "over the file, and in some rows of every station, payload, tool and direction."
    ]


def far_rows(made: Problem) -> list[str]:
    """Which rows fit neither model nor any pattern, where there are some."""
    odd = made.outliers
    if not len(odd.rows):
        return []
    lines = ", ".join(str(line) for line in sorted(made.given.lines[odd.rows[:8]])) + ", …" * (len(odd.rows) > 8)
    if odd.kept:
        return [f"Many rows are far from everything (first on lines {lines}); they were kept. Look at them."]
    many = len(odd.rows) > 1
    return [
        f"{len(odd.rows)} row{'s' * many} far from everything, on line{'s' * many} {lines}, "
        f"{'were' if many else 'was'} set aside for these tests. Look at {'them' if many else 'it'}."
    ]


def channel(cell: Cell) -> str:
    """The cell's channel in words."""
    return spoken(cell.channel, cell.sliding)


def variable(cell: Cell) -> str:
    """The cell's variable in words."""
    return cell.variable.replace("temp_", "temperature of ")


def p_text(p: float) -> str:
    """A corrected p for a table."""
    return "< 0.001" if p < 1e-3 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


CANDIDATES = ("effect", "visible", "s", "p", "in an explanation", "fitted alone", "note")
"""Header of :func:`candidate_rows`."""


def candidate_rows(found: Diagnosis, most: int | None = 12, longest: int = 90) -> list[tuple[str, ...]]:
    """Rows of the candidates' table: so many, all where None, and the user's own effects in any case; sizes are cut to
    so many characters."""
    rows = []
    for f in _listed(found, most)[0]:
        said = clipped(f.candidate.hypothesis.describe(f.theta), longest)
        rows.append(
            (
                f.candidate.spec, f"{100 * f.kappa:.0f} %", f"{f.s:.1f}", p_text(f.p), "yes" if f.adequate else "",
                said, f.why or "",
            )
        )  # fmt: skip
    return rows


def candidates_left(found: Diagnosis, most: int | None = 12) -> str:
    """What the candidates' table leaves out; empty where it is complete."""
    left = _listed(found, most)[1]
    if not left:
        return ""
    least = min(np.floor(100 * left[0].p) / 100, 0.99)
    return f"… and {len(left)} more" + (f", all p > {least:g}." if least > 0 else ".")


def _listed(found: Diagnosis, most: int | None) -> tuple[list[Finding], list[Finding]]:
    """The candidates to list, and those left out."""
    named = effects.names()
    shown: list[Finding] = []
    left: list[Finding] = []
    for f in one_per_effect(found):
        own = f.candidate.effect is not None and f.candidate.name not in named
        if own or f.why is not Why.UNSEEN:
            (shown if own or most is None or len(shown) < most else left).append(f)
    return shown, left


def limit_rows(found: Diagnosis) -> list[tuple[str, str]]:
    """Smallest sizes that would have been found, of every effect in its simplest variant."""
    seen: dict[str, tuple[str, str]] = {}
    for f in sorted(found.findings, key=lambda f: len(f.candidate.scale)):
        said = f.candidate.hypothesis.describe(f.smallest_seen)
        if f.candidate.name not in seen and said:
            finite = np.isfinite(f.smallest_seen).all()
            seen[f.candidate.name] = (f.candidate.spec, said if finite else "no size: invisible here")
    return sorted(seen.values())


def stale(c: Comparison) -> bool:
    """Whether a refit would bring the residuals of the model down to the noise."""
    noisy = bool(hot_cells(c.cells)) or c.misfit.p < HOT
    return not noisy and bool(c.misfit.dof) and c.times_noise[0] > MORE * c.misfit.times_noise


def comparison_sentence(c: Comparison) -> str:
    """The outcome of a comparison in one sentence."""
    times, held = c.times_noise
    turned = c.fit.rms_rot / c.noise.sigma_rot > MORE * c.fit.rms_pos / c.noise.sigma_pos
    text = f"Model and measurements differ by {_apart(c.fit, turned)} RMS, {times:.1f} times the noise"
    if held is not None and c.check is not None:
        text += f"; held-out poses by {_apart(c.check, turned)}, {held:.1f} times"
    if c.set_up_anew is not None:
        left = size(c.set_up_anew)
        return f"{text}. The tracker was set up anew: with its frame found from these rows, {left} RMS is left."
    hot, left = hot_cells(c.cells), c.misfit.times_noise
    spare = f" for the {c.misfit.dof} readings to spare" if (hot or c.misfit.p < HOT) and times < 1 else ""
    if hot:
        return f"{text}. More than noise{spare}: it shows in {place(hot[0])}."
    if c.misfit.p < HOT:
        return f"{text}. More than noise{spare}, but it follows none of the recorded variables."
    if stale(c):
        return f"{text}. The model does not fit these data; refitted to them it would leave {left:.1f} times noise."
    return f"{text}. No pattern stands out of the noise."


def comparison_details(c: Comparison) -> list[str]:
    """Details of a comparison, one sentence each: rows set aside, what a new fit would leave, and the noise."""
    out = [*looked_at(c.problem), *far_rows(c.problem)]
    left = c.misfit.times_noise
    if c.misfit.dof and not 1 / MORE < c.times_noise[0] / left < MORE:
        without = "Without them, and with" if len(c.problem.set_aside) else "With"
        out.append(f"{without} the geometry refitted, {left:.1f} times the noise is left of the rows to fit.")
    return [*out, noise_sentence(c.problem)]


def hot_cells(cells: Sequence[Cell]) -> list[Cell]:
    """Significant cells: the hottest, and those that stay significant beside the hottest explanation."""
    return [c for i, c in enumerate(cells) if c.p < HOT and (i == 0 or c.p_left < HOT)]


BEFORE_AFTER = ("", "rows", "RMS before", "after", "rotation before", "after", "χ²/dof before", "after")
"""Header of :func:`before_after`."""


def before_after(before: Fit, after: Fit) -> list[tuple[str, ...]]:
    """Rows fit and check with RMS of positions and rotations and χ² before and after."""
    rows = []
    for name, a, b in (("fit", before.accuracy, after.accuracy), ("check", before.check, after.check)):
        if a is not None and b is not None:
            rows.append(
                (
                    name, str(a.n_rows), size(a.rms_pos), size(b.rms_pos), angle(a.rms_rot), angle(b.rms_rot),
                    f"{a.chi2_dof:.2f}", f"{b.chi2_dof:.2f}",
                )
            )  # fmt: skip
    return rows


def _apart(a: Accuracy, turned: bool) -> str:
    """RMS of positions, and of rotations too where those say more."""
    return size(a.rms_pos) + (f" and {angle(a.rms_rot)}" if turned else "")


def step_sentence(step: Step) -> str:
    """How the residuals changed by a step, and whether held-out rows confirm it."""
    a, b = step.before, step.after
    name = step.spec
    word = "With" if step.action == "add" else "Without"
    text = f"{word} {name} the fit leaves {size(b.accuracy.rms_pos)} RMS, before {size(a.accuracy.rms_pos)}"
    held = step.held
    if a.check is None or b.check is None or held is None or step.fell is None:
        return text + "; there are too few held-out poses to confirm it."
    turned = held.by_rotations
    text += f"; held-out poses {_apart(b.check, turned)}, before {_apart(a.check, turned)}"
    if step.action == "drop":
        return text + (": it was needed." if held.refuted else ".")
    if not held.confirmed:
        return text + (": worse, drop it again." if held.refuted else ": no difference beyond chance.")
    left = np.sqrt(b.accuracy.chi2_dof)
    if b.accuracy.at_the_noise or not np.isfinite(left):
        return text + ": confirmed."
    return (
        f"{text}: better, but {left:.1f} times the stated noise is left. "
        "Something else is missing too, or the noise is larger than stated: 'pcalib diagnose' says which."
    )


def step_lines(step: Step) -> list[str]:
    """The effects of the new model with their sizes, and whether they are physically possible."""
    lines = []
    for f in step.after.candidate.effects:
        text = f"{f.effect.name}: {f.effect.describe(f.theta)}"
        for p, value, sigma in zip(
            f.effect.parameters, f.theta, f.sigma if f.sigma is not None else f.theta * np.nan, strict=True
        ):
            if value < p.low - 2 * sigma or value > p.high + 2 * sigma:
                text += f"; {p.name} lies outside its physical range: something else may be behind it"
        lines.append(text)
    return lines


def change(step: Step, name: str, value: float) -> str:
    """A change of a geometric parameter with its unit."""
    mechanism = step.after.candidate.robot.mechanism
    return deviation(value, mechanism.units[mechanism.index(name)], "+")


def evidence_sentence(e: Evidence) -> str:
    """The case for or against a candidate in one sentence."""
    c, theta = e.candidate, e.finding.theta
    words = c.hypothesis.sentence(np.clip(theta, c.low, c.high) if e.in_range else theta)
    if e.finding.why is Why.UNSEEN:
        if does_as_geometry(e.finding):
            return f"{e.candidate.name}: no poses can show it, a change of the geometry does the same."
        return f"{e.candidate.name}: these poses cannot show it, whatever its size."
    if not e.in_range:
        return f"Against {e.candidate.name}: its fitted size is physically impossible ({words})."
    if e.finding.p > HOT:
        said = f"{e.finding.s:.1f} noise units, as noise alone would give (p {p_text(e.finding.p)})"
        if e.finding.adequate:
            return f"Held-out poses ask for {e.candidate.name}. The rows to fit alone show only {said}."
        return f"Nothing speaks for {e.candidate.name}: {said}."
    if e.rest_p < HOT:
        return f"{e.candidate.name} helps, but is not enough: residuals are more than noise in {e.rest}."
    rivals = [r for r in e.rivals if r]
    if rivals:
        return f"{e.candidate.name} explains all there is, and so does {_or(rivals)}: {words}."
    return f"{e.candidate.name} explains all there is, and nothing else does: {words}."


def evidence_lines(e: Evidence) -> list[str]:
    """The figures for or against a candidate, one sentence each."""
    f = e.finding
    lines = [
        f"Visible: {100 * f.kappa:.0f} % of its signal; the geometry can take up the rest.",
        f"Size: {f.s:.1f} noise units, p {p_text(f.p)} after correcting for everything that was looked at.",
        f"With it in the model the most significant pattern is {e.rest}, p {p_text(e.rest_p)}.",
    ]
    if f.candidate.effect is not None:
        inside = np.all((f.theta >= f.candidate.low) & (f.theta <= f.candidate.high))
        doubt = ", by no more than noise can cause" if e.in_range and not inside else ""
        lines.append(f"Its parameters are {'within' if inside else 'outside'} their physical range{doubt}.")
        for p, value, sigma in zip(f.candidate.effect.parameters, f.theta, f.sigma, strict=True):
            from pcalib import units

            factor, unit = units.factor(p.unit), units.spoken(p.unit)
            doubt = f"± {figure(sigma / factor, 2)}" if np.isfinite(sigma) else "± unknown"
            lines.append(f"{p.name.replace('_', ' ')} = {figure(value / factor)} {doubt} {unit} (linear, on its own)")
    if e.held_out is not None:
        lines.append(f"Held-out readings: {_held_out(e.held_out)}.")
    else:
        lines.append("No held-out rows (set = check) that could confirm it.")
    return lines
