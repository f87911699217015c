"""Every output option of every command, by what the commands themselves declare: nothing that was there is lost."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import stat
import threading
import typing
from pathlib import Path

import pytest
from cyclopts import Parameter

from bench import cli as pcbench
from bench.jobs.attack import corpus
from pcalib import cli as pcalib
from pcalib.cli import _places
from pcalib.cli._places import Reads, Writes

PROGRAMS = {"pcalib": pcalib, "bench": pcbench}
COMMANDS = {
    f"{package}.cli.{file.stem}": package
    for package, program in PROGRAMS.items()
    for file in sorted(Path(program.__path__[0]).glob("*.py"))
    if not file.stem.startswith("_") and file.stem != "frame"
}
"""Module of every command → its program."""
GOOD = {
    "log": "log m.toml --back-to 1", "firmware": "firmware printer.toml --dialect klipper",
    "regress": "regress spec.toml --baseline fresh.json --update --reason made --no-speed",
    "plan": "plan --robot robot.toml -n 8 --to-tell backlash gear_ratio",
    "import": "import carriage-steps steps.csv --set rod=340mm --set radius=172mm",
}  # fmt: skip
"""Command lines that are not those of the attack."""
LIGHT = ("inspect", "log", "compensate", "join", "firmware", "effect", "import", "simulate")
"""Commands that take a tenth of a second: every option of theirs meets every case; of the others, each option one."""
CASES = ("device", "full", "fifo", "symlink", "0600", "newline")


def flags(command, name: str) -> str:
    """How an option is called on the command line."""
    parameter = inspect.signature(command, eval_str=True).parameters[name]
    for mark in typing.get_args(parameter.annotation)[1:]:
        if isinstance(mark, Parameter) and mark.name:
            return mark.name[0]
    return f"--{name.replace('_', '-')}"


def outputs(module: str) -> list[tuple[str, Writes]]:
    command = importlib.import_module(module).command
    return [(p.name, p.mark) for p in _places.declared(command) if isinstance(p.mark, Writes)]


OPTIONS = [(module, name) for module in COMMANDS for name, _ in outputs(module)]


def test_every_command_declares_its_outputs():
    """Nothing is a path by its type alone that the command writes: names of outputs are the marks'."""
    assert len(OPTIONS) > 40
    for module in COMMANDS:
        command = importlib.import_module(module).command
        written = re.findall(r"(?:write_text|save|write|atomic|write_json)\((\w+)", inspect.getsource(command))
        paths = {p.name: p.mark for p in _places.declared(command)}
        wrong = [name for name in written if isinstance(paths.get(name), Reads)]
        assert not wrong or module == "bench.cli.regress", f"{module} writes {wrong}"


@pytest.fixture
def line(tmp_path, monkeypatch):
    """line(module, name): a command line whose required files exist (as text of no use), and the first of them."""
    monkeypatch.chdir(tmp_path)

    def make(module: str) -> tuple[list[str], Path | None]:
        command, words, first = importlib.import_module(module).command, [], None
        marks = {p.name: p.mark for p in _places.declared(command)}
        for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
            if isinstance(marks.get(name), Writes):
                continue
            positional = parameter.kind in (parameter.POSITIONAL_ONLY, parameter.VAR_POSITIONAL)
            if parameter.default is not parameter.empty and not (positional and name in marks):
                continue
            units = [m for m in getattr(parameter.annotation, "__metadata__", ()) if getattr(m, "converter", None)]
            value = f"{name}.x" if name in marks else "1mm" if units else "x"  # quantities are read before files are
            mark = marks.get(name)
            if isinstance(mark, Reads) and mark.file(value) == value:
                Path(value).write_text("precious")
                first = first or Path(value)
            words += [value] if positional else [flags(command, name), value]
        return [module.rpartition(".")[2].replace("_", "-"), *words], first

    return make


@pytest.mark.parametrize(("module", "name"), OPTIONS)
def test_no_output_takes_the_place_of_something(module, name, line, capfd):
    """An input, a link to it, another output, a folder, a read-only file: refused before anything is read."""
    main, mark = PROGRAMS[COMMANDS[module]].main, dict(outputs(module))[name]
    command = importlib.import_module(module).command
    argv, first = line(module)
    required = [f for n, m in outputs(module) if n != name and _required(command, n)
                for f in (flags(command, n), f"other-{n}")]  # fmt: skip
    Path("kept").write_text("precious")
    Path("kept").chmod(0o444)
    Path("folder").mkdir()
    tried = {"kept": "read-only", "folder": "directory", "absent/new": "no such", "kept/new": "cannot write"}
    tried = {"kept/new": "cannot"} if mark.folder else tried
    if first is not None and not mark.folder:
        Path("link").symlink_to(first)
        os.link(first, "hard")
        same = "" if mark.over else "this file is read, and would be overwritten"
        tried |= dict.fromkeys((str(first), "link", "hard"), same)
    second = next((n for n, m in outputs(module) if n != name and not m.folder), None)
    for path, said in tried.items():
        before = {p: (p.read_bytes(), p.stat().st_mode) for p in Path().iterdir() if p.is_file()}
        code = main([*argv, *required, flags(command, name), path])
        err = capfd.readouterr().err
        assert code == 2 and re.search(said, err) and err.startswith("error: "), (path, err)
        assert {p: (p.read_bytes(), p.stat().st_mode) for p in Path().iterdir() if p.is_file()} == before
    if second is not None and not mark.folder:
        given = [w for n, m in outputs(module) if n not in (name, second) and _required(command, n)
                 for w in (flags(command, n), f"other-{n}")]  # fmt: skip
        assert main([*argv, *given, flags(command, name), "new", flags(command, second), "./new"]) == 2
        assert "named for two results" in capfd.readouterr().err and not Path("new").exists()


def _required(command, name: str) -> bool:
    parameter = inspect.signature(command).parameters[name]
    return parameter.default is parameter.empty


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("outputs")
    corpus.make(folder)
    return folder


def good_line(module: str) -> list[str] | None:
    """A command line that ends well, without its outputs."""
    program, _, name = module.partition(".cli.")
    if name in GOOD:
        return GOOD[name].split()
    command = importlib.import_module(module).command
    written = {flags(command, n) for n, _ in outputs(module)} | {"-o"}
    files = {"data": "data.csv", "robot": "robot.toml", "model": "soft.toml", "targets": "targets.csv",
             "truth": "truth.toml", "plan": "plan.csv", "spec": "spec.toml"}  # fmt: skip
    for role, file in files.items():
        for text in corpus.COMMANDS[role].strip().splitlines():
            words = text.split()
            if words[:2] == ["pcbench" if program == "bench" else "pcalib", name]:
                kept = [w for i, w in enumerate(words[1:]) if w not in written and words[i] not in written]
                return [file if w == "{}" else w for w in kept]
    return None


RUNS = [
    (module, turn)
    for module in COMMANDS
    if good_line(module) is not None and any(not mark.folder for _, mark in outputs(module))
    for turn in range(len(CASES) if module.rpartition(".")[2] in LIGHT else 1)
]


@pytest.mark.parametrize(("module", "turn"), RUNS)
def test_outputs_get_to_where_they_were_asked_for(module, turn, cell, tmp_path, monkeypatch, capfd):
    """Devices and FIFOs are written into, symlinks followed, modes kept; a full disk is said."""
    monkeypatch.chdir(cell)
    command = importlib.import_module(module).command
    argv = good_line(module) or []
    got: dict[str, bytes] = {}
    asked = {}
    for i, (name, mark) in enumerate(outputs(module)):
        case = "newline" if mark.folder else CASES[(i + turn) % len(CASES)]
        path = tmp_path / name
        if case == "device":
            path = Path("/dev/null")
        elif case == "full":
            path = Path("/dev/full")
        elif case == "fifo":
            os.mkfifo(path)
            threading.Thread(target=lambda p=path: got.update({str(p): p.read_bytes()}), daemon=True).start()
        elif case == "symlink":
            (tmp_path / f"{name}.target").write_text("old")
            path.symlink_to(f"{name}.target")
        elif case == "0600":
            path.write_text("old")
            path.chmod(0o600)
        else:
            path = tmp_path / f"{name}\nx"
        asked[name] = (case, path)
        argv += [flags(command, name), str(path)]
    before = {p: p.read_bytes() for p in cell.rglob("*") if p.is_file()}
    code = PROGRAMS[COMMANDS[module]].main(argv)
    err = capfd.readouterr().err
    assert "Traceback" not in err and not list(tmp_path.glob(".*"))
    assert {p: p.read_bytes() for p in before} == before
    full = any(case == "full" for case, _ in asked.values())
    assert code == (2 if full else 0) and ("/dev/full: cannot write: No space left" in err) == full, err
    for case, path in asked.values():
        if case in ("device", "full"):
            assert stat.S_ISCHR(path.stat().st_mode)
        elif case == "fifo":
            assert stat.S_ISFIFO(path.stat().st_mode)
            if full and str(path) not in got:  # nobody wrote: let the reader go
                os.close(os.open(path, os.O_WRONLY))
        elif case == "symlink":
            assert path.is_symlink() and (full or path.read_bytes() != b"old")
        elif case == "0600":
            assert stat.S_IMODE(path.stat().st_mode) == 0o600 and (full or path.read_bytes() != b"old")
        elif not full:
            assert path.exists()
