"""Files that commands read and write, declared as types of their parameters, and checked before the work begins.

A parameter of type `Path` is read, one with :class:`Writes` in its annotation is written. An output may be no input, no
second output and no folder.
"""

from __future__ import annotations

import inspect
import os
import stat
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter


@dataclass(frozen=True)
class Writes:
    """Marks a parameter as a file that the command writes."""

    over: str = ""
    """The parameter whose file it may replace, as it does where this parameter is absent."""
    beside: Callable[[Path], Path] | None = None
    """From the file to another one that is written with it."""
    folder: bool = False
    """Whether it is a folder of results."""


@dataclass(frozen=True)
class Reads:
    """Marks a parameter of text that may name a file."""

    file: Callable[[str], str] = str
    """From the text to the name of the file."""


JsonOption = Annotated[
    Path | None, Parameter(name="--json", help="Also write the result to this file, as JSON."), Writes()
]
OutputOption = Annotated[Path | None, Parameter(name=["--output", "-o"]), Writes()]
RewriteOption = Annotated[Path | None, Parameter(name=["--output", "-o"]), Writes(over="model")]
"""A model file to write; the model that is read where it is absent."""
RequiredOutput = Annotated[Path, Parameter(name=["--output", "-o"]), Writes()]
OutputFolder = Annotated[Path, Parameter(name=["--output", "-o"]), Writes(folder=True)]
BesideOption = Annotated[Path | None, Writes()]
"""A file that is written beside what a command prints."""


@dataclass(frozen=True)
class Declared:
    """A parameter that names files, with the mark that says how."""

    name: str
    default: Any
    mark: Writes | Reads


def declared(command: Callable[..., Any]) -> list[Declared]:
    """The parameters of a command that name files."""
    out = []
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        marks = [m for m in typing.get_args(parameter.annotation)[1:] if isinstance(m, (Writes, Reads))]
        if marks or _is_path(parameter.annotation):
            default = None if parameter.default is parameter.empty else parameter.default
            out.append(Declared(name, default, marks[0] if marks else Reads()))
    return out


def check(command: Callable[..., Any], given: Mapping[str, Any]) -> list[Path]:
    """Refuse outputs that cannot be written, or that would destroy an input or another output.

    Returns:
        Inputs that the command may write anew.

    Raises:
        InputError: an output has no place to go, is read, or is named twice.
    """
    from pcalib import files
    from pcalib.errors import InputError

    inputs: list[tuple[str, Path]] = []
    outputs: list[tuple[Writes, Path]] = []
    for parameter in declared(command):
        mark = parameter.mark
        for path in _each(given.get(parameter.name, parameter.default)):
            if isinstance(mark, Reads):
                inputs.append((parameter.name, Path(mark.file(str(path)))))
            elif mark.folder:
                files.check_folder(path)
            else:
                outputs += [(mark, each) for each in (path, *([mark.beside(path)] if mark.beside else []))]
    for number, (mark, path) in enumerate(outputs):
        files.check_places(path)
        if any(_same(path, other) for _, other in outputs[:number]):
            raise InputError("the file is named for two results", file=path, remedy="write to another file")
        if any(_same(path, file) for name, file in inputs if name != mark.over):
            raise InputError("this file is read, and would be overwritten", file=path, remedy="write to another file")
    over = {parameter.mark.over for parameter in declared(command) if isinstance(parameter.mark, Writes)}
    return [file for name, file in inputs if name in over]


def _each(value: Any) -> Iterator[Path]:
    values = value if isinstance(value, (tuple, list)) else (value,)
    return (Path(each) for each in values if each is not None)


def _is_path(annotation: Any) -> bool:
    """Whether a type is a path, or holds one, as `Path | None` and `tuple[Path, ...]` do."""
    return annotation is Path or any(_is_path(part) for part in typing.get_args(annotation))


def _same(one: Path, other: Path) -> bool:
    """Whether two paths are one file; a device takes several results one after the other."""
    try:
        there = one.stat()
        if not stat.S_ISREG(there.st_mode):
            return False
        if os.path.samestat(there, other.stat()):
            return True
    except (OSError, ValueError):
        pass
    return os.path.realpath(one) == os.path.realpath(other)
