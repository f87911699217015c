"""From what is clicked to the words of a command, and from what the command wrote to the next state of the session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pcalib import files
from pcalib.errors import InputError, unknown
from pcalib.workbench.session import Session, Step

ACTIONS = (
    "inspect", "fit", "compare", "diagnose", "look", "try", "add", "plan", "compensate", "propose", "view", "export",
)  # fmt: skip


@dataclass(frozen=True)
class Task:
    """A command to run, and what the page calls it."""

    action: str
    says: str
    words: tuple[str, ...]
    subject: str = ""
    """The effect or law that it is about."""


def task(action: str, session: Session, asked: Mapping[str, str]) -> Task:
    """The command of an action.

    Args:
        asked: what the page sent with it: `effect`, `between`, `targets`, `tool`, `to`, `level`.

    Raises:
        InputError: an unknown action, or one that the session is not ready for.
    """
    if action not in ACTIONS:
        raise InputError(unknown("action", action, ACTIONS))
    if not session.data or not session.robot:
        raise InputError("a data file and a robot file are needed first")
    data, robot, number = session.data, session.robot, len(session.steps) + 1
    step, effect = session.step, asked.get("effect", "")
    if effect.startswith("-"):
        raise InputError(f"'{effect}' is no effect")
    if action == "inspect":
        return Task(action, "Looking at the data", ("inspect", data, "--robot", robot, "--json", "inspect.json"))
    if action == "fit":
        level = asked.get("level") or "complete"
        out = ("-o", f"model{number}.toml", "--json", f"model{number}.json", "--report", f"model{number}.html")
        words = ("fit", data, "--robot", robot, "--level", level, *out)
        return Task(action, f"Fitting the geometry, level {level}", words)
    if step is None:
        raise InputError("a model is needed first: fit the data")
    name, model = Path(step.model).stem, ("--model", step.model)
    if action == "compare":
        out = ("--json", f"{name}.compare.json", "--report", f"{name}.compare.html")
        return Task(action, "Comparing model and measurements", ("compare", data, *model, *out))
    if action == "diagnose":
        out = ("--json", f"{name}.diagnose.json", "--report", f"{name}.diagnose.html")
        return Task(action, "Looking for what is missing", ("diagnose", data, *model, *out))
    if action in ("look", "try", "add"):
        if not effect:
            raise InputError("say which effect")
        if action == "look":
            out = ("--json", f"{name}.look.json", "--report", f"{name}.look.html")
            return Task(action, f"Weighing {effect}", ("explain", effect, data, *model, *out), effect)
        stem = f"model{number}" if action == "add" else f"{name}.try"
        out = ("-o", f"{stem}.toml", "--json", f"{stem}.json", "--report", f"{stem}.html")
        said = f"Adding {effect}" if action == "add" else f"Trying {effect}"
        return Task(action, said, ("add", effect, data, *model, *out), effect)
    if action == "plan":
        between = asked.get("between", "")
        words = ("next", data, *model, "--between", between, "-o", "plan.csv", "--json", "plan.json")
        return Task(action, f"Planning what tells {between.replace(',', ' from ')}", words)
    if action == "compensate":
        tool = asked.get("tool") or "0,0,0mm"
        out = ("--json", "commands.json", "-o", "commands.csv")
        words = ("compensate", asked.get("targets", ""), *model, "--tool", tool, *out)
        return Task(action, "Computing commands", words)
    if action == "propose":
        words = ("propose", data, *model, "-o", "laws", "--json", f"{name}.laws.json")
        return Task(action, "Searching for a law", words)
    if action == "view":
        words = ("view", step.model, "--save", f"{name}.rrd", "--json", f"{name}.view.json")
        return Task(action, "Drawing the robot", words)
    words = ("export", step.model, "--to", asked.get("to") or "c", "-o", "controller")
    return Task(action, "Writing code for the controller", words)


def done(session: Session, task: Task) -> Session:
    """The session after a command has ended well."""
    after = replace(session, commands=(*session.commands, task.words))
    if task.action not in ("fit", "add"):
        return after
    stem = f"model{len(session.steps) + 1}"
    written = read(session.source / f"{stem}.json")
    fit = written.get("after") or written
    check = fit.get("check") or {}
    figures = {
        "rms": fit.get("rms_pos_um"), "rms_check": check.get("rms_pos_um"),
        "rms_rot": fit.get("rms_rot_urad"), "u95": (written.get("uncertainty") or {}).get("u95_um"),
    }  # fmt: skip
    title = f"+ {task.subject}" if task.action == "add" else str(fit.get("level", "fit"))
    kept = session.steps if task.action == "add" else ()
    step = Step(title, f"{stem}.toml", figures, f"{stem}.html")
    return replace(after, steps=(*kept, step), at=len(kept))


def read(path: Path) -> dict[str, Any]:
    """The JSON that a command wrote; empty where there is none."""
    if not path.exists():
        return {}
    return files.parse_json(files.read_text(path), path, "run the command again")
