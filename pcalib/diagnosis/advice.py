"""What to measure or do after a diagnosis, for people and for programs: commands with all of their words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcalib.diagnosis.diagnose import Diagnosis, Finding, Why
from pcalib.diagnosis.patterns import HOT, spoken
from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.verdict import Against

SAME = 1e-6
"""κ below which an effect is a change of the geometry by another name."""

_TENTATIVE = {"meanwhile": "to go on with {} until then", "try": "to try {}, which is not established"}
"""Kind of advice on an effect that is not established → purpose of the command."""


@dataclass(frozen=True)
class Advised:
    """A step to take next."""

    why: str
    """What it is for, as it follows on 'Next, '; or all there is to say where no command belongs to it."""
    words: tuple[str, ...] = ()
    """Words of the command of this program, but for the options that name files of effects."""


def advised(found: Diagnosis, model: str) -> list[Advised]:
    """What to do next.

    Args:
        model: name of the model's file.
    """
    data, out = found.problem.given.source, []
    shared = found.established if found.verdict == "ambiguous" else ()
    for item in advice(found):
        if item["do"] == "next":
            vary = f" (vary {', '.join(item['vary'])})" if item["vary"] else ""
            first = "with that model, " if shared else ""
            between = ("--between", ",".join(item["between"]), "-n", "10", "-o", "more.csv")
            why = f"{first}to plan poses that tell them apart{vary}"
            out.append(Advised(why, ("next", data, "--model", model, *between)))
        elif item["do"] == "add":
            why = f"to add {item['effect']}, which is missing in any case" if shared else "to refit everything with it"
            out.append(Advised(why, ("add", item["effect"], data, "--model", model)))
        elif item["do"] in _TENTATIVE:
            why = _TENTATIVE[item["do"]].format(item["effect"])
            out.append(Advised(why, ("add", item["effect"], data, "--model", model)))
        elif item["do"] in ("refit", "changed"):
            out.append(mended(found.problem, model))
        elif item["do"] == "write an effect":
            where = spoken(item["channel"], found.problem.model.robot.mechanism.actuator_dimension == "length")
            why = f"to write an effect of your own that moves {where} by {item['variable']}"
            out.append(Advised(why, ("effect", "new", "MyEffect")))
        elif item["do"] == "replicate":
            out.append(Advised("Measure ten poses twice (same pose_id): they say what is noise."))
        elif item["do"] == "vary":
            out.append(Advised(f"To see {item['for']}, the data need {', '.join(item['vary']) or 'other poses'}."))
    return out


def mended(made: Problem, model: str) -> Advised:
    """The step that mends a model which does not fit the data as it stands, where a refit does."""
    data = made.given.source
    if not refits(made):
        return Advised("to find what changed since it was fitted", ("changed", data, "--model", model))
    robust = ("--loss", "huber") if len(made.outliers.rows) else ()
    chosen = ("--level", made.model.level, *robust, "-o", "refit.toml")
    words = ("fit", data, "--robot", f"{made.model.robot.name}.toml", *chosen)
    return Advised("with the robot file of this model, to refit it", words)


def fitted_to(made: Problem) -> bool:
    """Whether the last fit of the model was made from this file."""
    history = made.model.history
    return bool(history) and Path(str(history[-1].get("data", ""))).name == Path(made.given.source).name


def refits(made: Problem) -> bool:
    """Whether to advise a refit: the model was fitted to this very file, or gross rows have bent the fit."""
    return fitted_to(made) or bool(len(made.outliers.rows))


def advice(found: Diagnosis) -> list[dict[str, Any]]:
    """What to measure or do next."""
    out: list[dict[str, Any]] = []
    if Against.STALE in found.given.against:
        out.append({"do": "refit" if refits(found.problem) else "changed"})
    if found.verdict == "ambiguous" and len(found.sets) == 1 and not found.established:
        out += [{"do": "try", "effect": h.spec} for h in found.sets[0].members]
    if found.verdict == "ambiguous" and len(found.sets) > 1:
        best = found.sets[0]
        shared = [h for h in best.members if h.name in found.established]
        out += [{"do": "add", "effect": c.spec} for c in sorted(shared, key=lambda h: h.effect is not None)]
        rivals = [[h for h in e.members if h.name not in found.established] for e in found.sets[:2]]
        wants = sorted({w for rival in rivals for h in rival for w in h.wants})
        out.append({"do": "next", "between": ["+".join(h.spec for h in rival) for rival in rivals], "vary": wants})
        if len(rivals[0]) == 1 and not (found.established or best.doubts or best.implausible):
            out.append({"do": "meanwhile", "effect": rivals[0][0].spec})
    elif found.established:
        sure = [h for e in found.sets[:1] for h in e.members if h.name in found.established]
        out += [{"do": "add", "effect": h.spec} for h in sure]
    if found.nearly is not None:
        out += [{"do": "add", "effect": spec} for spec in found.nearly.explanation.specs]
    elif found.verdict == "unexplained":
        out += [
            {"do": "write an effect", "channel": c.channel, "variable": c.variable}
            for c in found.cells[:2]
            if c.p < HOT
        ]
    if not found.noise.verified:
        out.append({"do": "replicate", "why": "the noise is not verified: measure ten poses twice"})
    blind = sorted({f.candidate.name for f in found.findings if f.why is Why.UNSEEN and not does_as_geometry(f)})
    for name in blind:
        of = [f.candidate.hypothesis for f in found.findings if f.candidate.name == name]
        if found.problem.given.frame == "base" and all(h.effect and h.effect.channels == ("sensor",) for h in of):
            continue  # an instrument that stands in the base frame has been laid out by some length standard
        wants = [w for h in of for w in h.wants]
        out.append({"do": "vary", "for": name, "vary": list(dict.fromkeys(wants))})
    return out


def does_as_geometry(f: Finding) -> bool:
    """Whether a change of the geometry has exactly the effect's signal, at any poses."""
    return f.kappa < SAME
