"""The errors a user can meet. Each message says what is wrong, where, and what to do next.

Every one derives from :class:`PcalibError`; the command lines print it without a traceback and exit with 2.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path


class PcalibError(Exception):
    """Base of all errors that pcalib and the bench raise on purpose."""


class InputError(PcalibError):
    """A file, option or value that cannot be used as it stands."""

    def __init__(
        self,
        problem: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        column: str | None = None,
        remedy: str = "",
    ):
        self.problem, self.file, self.line, self.column, self.remedy = problem, file, line, column, remedy
        where = ""
        if file is not None:
            where = f"{file}" + (f":{line}" if line is not None else "") + ": "
        elif line is not None:
            where = f"line {line}: "
        if column is not None:
            where += f"column '{column}': "
        super().__init__(where + problem + (f"\n  {remedy}" if remedy else ""))


class FitError(PcalibError):
    """An identification that did not converge, or that the data cannot support."""


class ReachError(PcalibError):
    """A pose that the robot cannot take: outside its workspace, past a joint limit or on another branch."""


class EffectError(PcalibError):
    """An effect, of the library or of the user's own, that cannot be used."""


def unknown(what: str, given: str, accepted: Iterable[str]) -> str:
    """One sentence for a name that is not known: the nearest accepted one first, then all."""
    names = list(accepted)
    near = get_close_matches(given, names, n=1)
    hint = f" (did you mean '{near[0]}'?)" if near else ""
    return f"unknown {what} '{given}'{hint}; accepted: {', '.join(names) or 'none'}"
