"""From what is clicked to the words of a command, and from what the command wrote to the next state of the session."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pcalib import files
from pcalib.errors import InputError, unknown
from pcalib.workbench.session import LAW, ModelStep, Session, Wanted

ACTIONS = (
    "inspect", "join", "fit", "compare", "diagnose", "look", "try", "add", "plan", "compensate", "propose", "view",
    "export", "cell",
)  # fmt: skip
CHAINS = {"begin": ("inspect", "fit", "compare", "diagnose", "view"), "add": ("add", "compare", "diagnose", "view")}
"""Actions that follow one by themselves: new data are fitted, and every new model is looked at."""

LISTED = re.compile(r"[a-z]\w*([:@][\w.]+)*", re.ASCII)
"""A listed effect, level or part, with its variant. A file of the user's own never matches: a page, or the record of a
session that came from elsewhere, must not run code. A law of the session runs once its code was shown and agreed to."""


@dataclass(frozen=True)
class Task:
    """A command to run, and what the page calls it."""

    action: str
    says: str
    words: tuple[str, ...]
    asked: Mapping[str, str] = field(default_factory=dict)
    """What the page sent with it."""
    model: str = ""
    """The model file of the step that it makes; empty where it makes none."""

    @property
    def subject(self) -> str:
        """The effect or law that it is about."""
        return self.asked.get("effect", "")


def tasks(action: str, session: Session, asked: Mapping[str, str], agreed: Collection[str] = ()) -> list[Task]:
    """The command of an action and those that follow it by themselves.

    Rows that are joined are fitted together with those that were there, by all steps of the history.

    Args:
        agreed: laws whose code may run.

    Raises:
        InputError: as for `task`.
    """
    if action == "more":
        again = [made for step in session.steps if (made := _made_by(step, session)) is not None]
        wanted = [Wanted("join", asked), Wanted("inspect", {}), *again]
        return queue([*wanted, *(Wanted(one, {}) for one in ("compare", "diagnose", "view"))], session, agreed)
    return queue([Wanted(one, asked) for one in CHAINS.get(action, (action,))], session, agreed)


def _made_by(step: ModelStep, session: Session) -> Wanted | None:
    """The action that made a step."""
    for words in reversed(session.commands):
        if step.model in words and words[0] in ("fit", "add") and words[words.index("-o") + 1] == step.model:
            fit = words[0] == "fit"
            return Wanted(words[0], {"level": words[words.index("--level") + 1]} if fit else {"effect": words[1]})
    return None


def queue(wanted: Sequence[Wanted], session: Session, agreed: Collection[str] = ()) -> list[Task]:
    """The commands of actions, each in the session as those before it will leave it.

    Raises:
        InputError: as for `task`.
    """
    out = []
    for one in wanted:
        out.append(task(one.action, session, one.asked, one.model, agreed))
        session = with_step(session, out[-1], {})
    return out


def task(
    action: str, session: Session, asked: Mapping[str, str], model_file: str = "", agreed: Collection[str] = ()
) -> Task:
    """The command of an action.

    Args:
        asked: what the page sent with it: `effect`, `between`, `targets`, `rows`, `cell`, `tool`, `to`, `level`.
        model_file: the model that it makes, where it was begun before; empty: a new name.
        agreed: laws whose code may run.

    Raises:
        InputError: an unknown action, or one that the session is not ready for.
    """
    if action not in ACTIONS:
        raise InputError(unknown("action", action, ACTIONS))
    if not session.data or not session.robot:
        raise InputError("a data file and a robot file are needed first")
    data, robot, fresh = session.data, session.robot, Path(model_file).stem or session.fresh()
    step, effect = session.step, asked.get("effect", "")
    for key, value in asked.items():
        if value.startswith("-") and key != "tool":
            raise InputError(f"'{value}' is no {key}")
    for spec in (effect, *asked.get("between", "").replace("+", ",").split(",")):
        if spec and not LISTED.fullmatch(spec) and spec not in agreed:
            raise InputError(
                f"'{spec}' is no listed effect", remedy="effects of your own run from the command line only: pcalib add"
            )
    if action == "inspect":
        return Task(action, "Looking at the data", ("inspect", data, "--robot", robot, "--json", "inspect.json"), asked)
    if action == "join":
        joined = f"joined{sum(words[0] == 'join' for words in session.commands) + 1}.csv"
        words = ("join", data, asked.get("rows", ""), "-o", joined, "--json", "join.json")
        return Task(action, f"Joining {asked.get('rows', '')} to {data}", words, asked)
    if action == "fit":
        level = asked.get("level") or "complete"
        words = ("fit", data, "--robot", robot, "--level", level, *_written(fresh))
        return Task(action, f"Fitting the geometry, level {level}", words, asked, f"{fresh}.toml")
    if step is None:
        raise InputError("a model is needed first: fit the data")
    if unknown_code := [spec for spec in step.code if spec not in agreed]:
        raise InputError(f"this model runs the code of {unknown_code[0]}", remedy="look at it, and agree to it")
    name = Path(step.model).stem
    model = ("--model", step.model, *(word for spec in step.code for word in ("--effect-file", spec)))
    if action == "compare":
        out = ("--json", f"{name}.compare.json", "--report", f"{name}.compare.html")
        return Task(action, "Comparing model and measurements", ("compare", data, *model, *out), asked)
    if action == "cell":
        cell = asked.get("cell", "")
        words = ("compare", data, *model, "--cell", cell, "--report", f"{name}.cell.html")
        return Task(action, f"Drawing {cell.replace(':', ' by ')}", words, asked)
    if action == "diagnose":
        out = ("--json", f"{name}.diagnose.json", "--report", f"{name}.diagnose.html")
        return Task(action, "Looking for what is missing", ("diagnose", data, *model, *out), asked)
    if action in ("look", "try", "add"):
        if not effect:
            raise InputError("say which effect")
        if action == "look":
            out = ("--json", f"{name}.look.json", "--report", f"{name}.look.html")
            return Task(action, f"Weighing {effect}", ("explain", effect, data, *model, *out), asked)
        if action == "try":
            words = ("add", effect, data, *model, *_written(f"{name}.try"))
            return Task(action, f"Trying {effect}", words, asked)
        words = ("add", effect, data, *model, *_written(fresh))
        return Task(action, f"Adding {effect}", words, asked, f"{fresh}.toml")
    if action == "plan":
        between = asked.get("between", "")
        words = ("next", data, *model, "--between", between, "-o", "plan.csv", "--json", "plan.json")
        return Task(action, f"Planning what tells {between.replace(',', ' from ')}", words, asked)
    if action == "compensate":
        tool = asked.get("tool") or "0,0,0mm"
        out = ("--json", "commands.json", "-o", "commands.csv")
        words = ("compensate", asked.get("targets", ""), *model, "--tool", tool, *out)
        return Task(action, "Computing commands", words, asked)
    if action == "propose":
        words = ("propose", data, *model, "-o", "laws", "--json", f"{name}.laws.json")
        return Task(action, "Searching for a law", words, asked)
    if action == "view":
        words = ("view", step.model, *model[2:], "--save", f"{name}.rrd", "--json", f"{name}.view.json")
        return Task(action, "Drawing the robot", words, asked)
    words = ("export", step.model, *model[2:], "--to", asked.get("to") or "c", "-o", "controller")
    return Task(action, "Writing code for the controller", words, asked)


def _written(stem: str) -> tuple[str, ...]:
    """The options for the files of a fit."""
    return ("-o", f"{stem}.toml", "--json", f"{stem}.json", "--report", f"{stem}.html")


def done(session: Session, task: Task) -> Session:
    """The session after a command has ended well."""
    after = replace(session, commands=(*session.commands, task.words))
    if not task.model:
        return with_step(after, task, {})
    written = read(session.source / f"{Path(task.model).stem}.json")
    fit = written.get("after") or written
    check = fit.get("check") or {}
    figures = {
        "rms": fit.get("rms_pos_um"), "rms_check": check.get("rms_pos_um"),
        "rms_rot": fit.get("rms_rot_urad"), "u95": (written.get("uncertainty") or {}).get("u95_um"),
    }  # fmt: skip
    return with_step(after, task, figures, str(fit.get("level", "fit")))


def with_step(session: Session, task: Task, figures: dict[str, Any], level: str = "") -> Session:
    """The session after a command: with the step that it made, or the data that it joined; unchanged after any other.

    A fit starts a new history. An effect that is added to a step before the last has the number of that step in its
    title.
    """
    if task.action == "join":
        return replace(session, data=task.words[task.words.index("-o") + 1])
    if not task.model:
        return session
    code: tuple[str, ...] = ()
    if task.action != "add":
        kept, title = (), level
    else:
        kept, base = session.steps, task.words[task.words.index("--model") + 1]
        number = next((i for i, step in enumerate(kept, start=1) if step.model == base), len(kept))
        name = task.subject.rpartition(":")[2] if LAW.fullmatch(task.subject) else task.subject
        title = f"+ {name}" if number == len(kept) else f"{number} + {name}"
        code = (*kept[number - 1].code, *([task.subject] if name != task.subject else []))
    step = ModelStep(title, task.model, figures, f"{Path(task.model).stem}.html", code)
    return replace(session, steps=(*kept, step), at=len(kept))


def read(path: Path) -> dict[str, Any]:
    """The JSON that a command wrote; empty where there is none."""
    if not path.exists():
        return {}
    return files.parse_json(files.read_text(path), path, "run the command again")
