"""The errors that a user can meet. Each message says what is wrong, where, and what to do next.

Every error derives from :class:`PcalibError`. The command lines print its message without a traceback and exit with 2.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from enum import Enum
from pathlib import Path
from typing import Any


class PcalibError(Exception):
    """Base of all errors that pcalib and the bench raise on purpose."""


class BadInput(Enum):
    """Kinds of bad input by which a caller decides; no caller reads the text of a message."""

    OTHER = "other"
    UNKNOWN_KEY = "unknown key"


class InputError(PcalibError):
    """A file, option or value that cannot be used as it stands.

    Args:
        problem: What is wrong, in one sentence.
        code: The kind of problem, where a caller decides by it.
        key: The key of a TOML file that is to blame,
        section: and the section it stands in; both give the line of the message.
        file, line, column: Where the problem is.
        remedy: What to do next.
    """

    def __init__(
        self,
        problem: str,
        *,
        code: BadInput = BadInput.OTHER,
        key: str | None = None,
        section: str | None = None,
        file: str | Path | None = None,
        line: int | None = None,
        column: str | None = None,
        remedy: str = "",
    ):
        self.problem, self.code, self.key, self.section = problem, code, key, section
        self.file, self.line, self.column, self.remedy = file, line, column, remedy
        where = ""
        if file is not None:
            where = f"{file}" + (f":{line}" if line is not None else "") + ": "
        elif line is not None:
            where = f"line {line}: "
        if column is not None:
            where += f"column '{column}': "
        super().__init__(where + problem + (f"\n  {remedy}" if remedy else ""))

    def but(self, **changed: Any) -> InputError:
        """The same error with some of its parts changed, such as the file that the raiser did not know."""
        names = ("problem", "code", "key", "section", "file", "line", "column", "remedy")
        return InputError(**{name: getattr(self, name) for name in names} | changed)


class FitError(PcalibError):
    """An identification that did not converge, or that the data cannot support."""


class ReachError(PcalibError):
    """A pose that the robot cannot take: outside its workspace, past a joint limit or on another branch."""


class EffectError(PcalibError):
    """An effect, of the library or of the user's own, that cannot be used."""


def unknown(what: str, given: str, accepted: Iterable[str]) -> str:
    """A sentence that says that a name is not known, which accepted name is nearest, and which names are accepted."""
    names = list(accepted)
    near = get_close_matches(given, names, n=1)
    hint = f" (did you mean '{near[0]}'?)" if near else ""
    return f"unknown {what} '{given}'{hint}; accepted: {', '.join(names) or 'none'}"
