"""The folder of a session: data, robot, models and figures as the commands wrote them, and a record of the commands.

A session is read back from its folder, so that it goes on wherever it was interrupted.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pcalib import files, outputs
from pcalib.errors import InputError

RECORD = "session.json"
SHAPE = {
    "data": str, "robot": str, "at": float, "commands": [[str]],
    "steps": [{"title": str, "model": str, "figures": {"*": (float,)}, "report": str}],
    "pending": [{"action": str, "asked": {"*": str}}],
}  # fmt: skip
LARGEST = 64 * 2**20
"""[bytes] largest file that is handed over: a million poses as text."""
_MODEL = re.compile(r"model\d+\.toml", re.ASCII)
LAW = re.compile(r"laws/[a-z0-9_]{1,80}\.py:[A-Za-z]\w{0,80}", re.ASCII)
"""A law that was proposed in the session's folder."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,99}")


@dataclass(frozen=True)
class ModelStep:
    """One model of the history."""

    title: str
    """'complete', '+ thermal_rods'."""
    model: str
    """Name of the model file."""
    figures: dict[str, Any]
    """rms, rms_check [µm] and u95 [µm], where they are known."""
    report: str = ""
    """Name of the report of the fit."""
    code: tuple[str, ...] = ()
    """Laws that the model needs, 'laws/file.py:Class' each: code that runs only once somebody has agreed to it."""


@dataclass(frozen=True)
class Wanted:
    """An action that a click asked for and that waits or runs."""

    action: str
    asked: Mapping[str, str]
    """What the page sent with it."""
    model: str = ""
    """The model file that it makes, which may be there in part: a session that goes on writes it anew."""


@dataclass(frozen=True)
class Session:
    """The record of a session: its files, its steps and the actions that wait."""

    data: str = ""
    robot: str = ""
    steps: tuple[ModelStep, ...] = ()
    commands: tuple[tuple[str, ...], ...] = ()
    """Words of each command that was run to its end, oldest first, without the program's name."""
    at: int = -1
    """Which step is looked at; −1: the last one."""
    pending: tuple[Wanted, ...] = ()
    """Actions that ran or waited when this was written, with what was asked: a killed session goes on with them."""
    source: Path = field(default=Path(), compare=False)
    """The folder."""

    @property
    def step(self) -> ModelStep | None:
        """The step that is looked at."""
        return self.steps[self.at] if self.steps else None

    def fresh(self) -> str:
        """Name of the next model, without ending: a number that no file of the folder and no step has."""
        names = [*(f.name for f in self.source.glob("model*")), *(step.model for step in self.steps)]
        numbers = [int(found[1]) for name in names if (found := re.match(r"model(\d+)\.", name))]
        return f"model{max(numbers, default=0) + 1}"

    def as_json(self) -> dict[str, Any]:
        """What the record of the session holds."""
        out = asdict(self)
        out.pop("source")
        return out

    def shell(self) -> str:
        """The session as a shell script."""
        lines = "".join(f"pcalib {shlex.join(words)}\n" for words in self.commands)
        about = "# What the window did, command by command. Run it in the session's folder."
        return f"#!/usr/bin/env bash\n{about}\nset -e\n{lines}"

    def python(self) -> str:
        """The session as a Python script."""
        calls = "".join(f"run({', '.join(map(repr, words))})\n" for words in self.commands)
        return (
            '"""What the window did, command by command. Run it in the session\'s folder."""\n\nimport sys\n\n'
            "from pcalib.cli import main\n\n\ndef run(*words: str) -> None:\n"
            "    if code := main(words):\n        sys.exit(code)\n\n\n" + calls
        )


def load(folder: Path) -> Session:
    """The session of a folder; an empty one where it has no record.

    Raises:
        InputError: the record is damaged.
    """
    record = folder / RECORD
    if not record.exists():
        return Session(source=folder)
    remedy = "move it away to begin anew; the models and figures in the folder stay"
    found = files.parse_json(files.read_text(record), record, remedy)
    files.require_shape(found, SHAPE, record, remedy)
    keys = SHAPE["steps"][0]
    steps = tuple(ModelStep(**{key: step[key] for key in keys}, code=_code_of(step)) for step in found["steps"])
    named = [found["data"], found["robot"], *(name for step in steps for name in (step.model, step.report))]
    for name in named:
        if name and not is_name(name):  # it becomes a word of a command
            raise InputError(f"'{name:.40}' is no name for a file here", file=record, remedy=remedy)
    commands = tuple(map(tuple, found["commands"]))
    pending = tuple(Wanted(one["action"], one["asked"], _model_of(one)) for one in found["pending"])
    at = min(int(found["at"]), len(steps) - 1)
    return Session(found["data"], found["robot"], steps, commands, max(at, -1), pending, folder)


def _code_of(step: Mapping[str, Any]) -> tuple[str, ...]:
    """The laws of a step; records of earlier versions have none."""
    code = step.get("code", [])
    known = code if isinstance(code, list) else []
    return tuple(spec for spec in known if isinstance(spec, str) and LAW.fullmatch(spec))


def _model_of(pending: Mapping[str, Any]) -> str:
    """The model file that an action makes; records of earlier versions do not have it."""
    name = pending.get("model", "")
    return name if isinstance(name, str) and _MODEL.fullmatch(name) else ""


def save(session: Session) -> None:
    """Write the record."""
    outputs.may_rewrite([session.source / RECORD])
    files.write_text(session.source / RECORD, json.dumps(session.as_json(), indent=1, ensure_ascii=False))


def is_name(name: str) -> bool:
    """Whether a name is that of a file in a session's folder: no path, nothing hidden."""
    return bool(_NAME.fullmatch(name)) and ".." not in name


def kind_of(name: str, content: bytes) -> str:
    """'robot' or 'data' of a file that was handed over, by its content."""
    text = content[:65536]
    if name.lower().endswith(".toml") or (b"[geometry]" in text and b"kind" in text):
        return "robot"
    return "data"


def names(session: Session, suffixes: Sequence[str]) -> list[str]:
    """Files of the folder with one of these endings, sorted."""
    return sorted(f.name for f in session.source.iterdir() if f.suffix in suffixes and is_name(f.name))
