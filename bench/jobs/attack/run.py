"""Run an attack: every case ends with 0, 1 or 2, in time, within memory, and leaves everything else as it was.

A case is made from the seed and its number alone, so that one that fails can be tried again: ``--only 1234``.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from bench.jobs.attack import corpus
from bench.jobs.attack.mutation import damaged, odd_options
from pcalib.cli import frame
from pcalib.errors import PcalibError

SECONDS, WAITING = 20, 300
"""[s] of processor time and of the clock after which a case counts as hanging."""
MEMORY = 1_000_000_000
"""[bytes] of memory that the whole attack may take."""
READ_SHARE = 0.92
"""Share of the cases that go to a reader; the others go through a command, which takes fifty times as long."""
SLOW = ("diagnose", "explain", "next", "demo", "blind", "campaign", "regress", "verify", "propose")
"""Commands that take seconds where their input is good: files that can be read are rarely given to them."""
FILES = {
    "data": "data.csv", "robot": "robot.toml", "model": "m.toml", "targets": "targets.csv", "truth": "truth.toml",
    "plan": "plan.csv", "spec": "spec.toml", "baseline": "base.json", "steps": "steps.csv", "capture": "capture.csv",
    "sealed": "blind/sealed/001.json", "diagnosis": "blind/001.diagnosis.json", "parquet": "data.parquet",
    "sensed": "sensed.csv", "gauge": "gauge.csv", "axes": "axes.csv", "setup": "setup.toml", "commands": "commands.csv",
    "points": "points.txt", "matrices": "matrices.txt", "motive": "motive.csv", "vicon": "vicon.csv",
    "heights": "heights.csv", "probed": "probed.txt",
}  # fmt: skip
"""The good file of each role."""


class Hang(BaseException):
    """A case takes too long."""


@dataclass(frozen=True)
class Case:
    """One damaged file or odd command line."""

    number: int
    role: str
    content: bytes | None
    """The damaged file; None where a command line is odd."""
    argv: tuple[str, ...]
    """The command; empty where only the reader is asked."""

    @property
    def name(self) -> str:
        """The damaged file's name in the folder."""
        good = FILES.get(self.role, "data.csv")
        return good if self.role in ("sealed", "diagnosis") else f"bad{Path(good).suffix}"


@dataclass(frozen=True)
class Outcome:
    """How a case ended."""

    code: int
    wrong: str
    """What is wrong with it; empty where it ended as it should."""


def readers() -> dict[str, Callable[[Path], Any]]:
    """The reader of every role."""
    from bench import plan as plans
    from bench import truth
    from bench.jobs import score
    from bench.jobs.campaign import regress, spec
    from pcalib import importers, modelfile, recordings
    from pcalib import robot as robots
    from pcalib.data import measurement, targets
    from pcalib.data.measurement import Measurements
    from pcalib.inspection import inspect
    from pcalib.recordings import dwells, pairing

    delta = robots.load(corpus.DELTA)
    campaign = spec.load(Path("spec.toml"))

    def data(path: Path) -> None:
        """What was loaded is sound, can be inspected, and is the same when it is saved and loaded again."""
        loaded = measurement.load(path, delta)
        for values in (loaded.q, loaded.tool, loaded.payload, loaded.sigma, *loaded.columns.values()):
            assert np.isfinite(values).all()
        posed = np.ones(len(loaded), bool) if loaded.readings is None else loaded.readings.sensor == ""
        assert (loaded.sigma > 0).all() and (np.isfinite(loaded.position) == loaded.mask[:, :3])[posed].all()
        inspect(loaded, delta).to_json()
        measurement.save("again.csv", loaded)
        again = measurement.load("again.csv", delta)
        assert again.mask.sum() == loaded.mask.sum()
        if loaded.readings is not None and loaded.readings.origin is not None:
            return  # a pose whose distance to another is read has more rows, which are put in another order
        assert np.allclose(again.q, loaded.q, rtol=1e-13, atol=1e-15)
        assert np.allclose(again.position, loaded.position, rtol=1e-13, atol=1e-15, equal_nan=True)

    def commands(path: Path) -> Measurements:
        return measurement.load(path, delta, measured=False)

    asked = commands(Path("commands.csv"))

    def recording(form: str, by: str) -> Callable[[Path], None]:
        """A reader, the stops of what it reads, and its pairing with the commands."""

        def read(path: Path) -> None:
            found = recordings.FORMS.get(form).read(path)
            paired, _ = pairing.measured(dwells.dwells(found), asked, delta, by, (None, None))
            measurement.save("again.csv", paired)

        return read

    return {
        "data": data,
        "parquet": data,
        "robot": robots.load,
        "model": modelfile.load,
        "targets": lambda path: targets.load_targets(path, delta),
        "truth": truth.load,
        "plan": lambda path: plans.make(delta, path),
        "spec": spec.load,
        "baseline": lambda path: regress.load(path, campaign),
        "steps": lambda path: importers.run("carriage-steps", path, ()),
        "capture": lambda path: importers.run("motion-capture", path, ()),
        "sealed": lambda path: score.score(path.parents[1]),
        "diagnosis": lambda path: score.score(path.parent),
        "sensed": data,
        "gauge": data,
        "axes": data,
        "setup": modelfile.load,
        "commands": commands,
        "points": recording("point-list", "name"),
        "matrices": recording("matrices", "order"),
        "motive": recording("motive", "time"),
        "vicon": recording("vicon", "order"),
        "heights": lambda path: importers.run("bed-heights", path, ()),
        "probed": lambda path: importers.run("bed-heights", path, ()),
    }


def prepare(folder: Path) -> None:
    """Good files of every role, those that only commands write included."""
    from pcalib import robot as robots
    from pcalib.data import measurement

    corpus.make(folder)
    with contextlib.chdir(folder), _quiet():
        Path("base.json").unlink()
        made = _program("pcbench")(["regress", "spec.toml", "--baseline", "base.json", "--update", "--reason", "made",
                                    "--no-speed"])  # fmt: skip
        assert made == frame.OK
        measurement.save("data.parquet", measurement.load("data.csv", robots.load("robot.toml")))
        legs, place = [f"leg_length_{i}" for i in range(1, 7)], [f"position_{c}" for c in "xyz"]
        heading = ",".join([*legs, *place, *(f"orientation_{c}" for c in "xyzw")]) + "\n"
        rows = "".join(f"1,2,3,4,5,{i},{i},{i % 3},100,0,0,0,1\n" for i in range(8))
        Path("capture.csv").write_text(heading + rows)
        Path("blind/sealed/001.json").write_text(
            '{"schema": "pcbench.sealed/1", "data": "001.csv", "design": "rich", "effects": ["backlash"], '
            '"faults": [{"fault": "backlash"}], "s": 8.0, "s_outside": 0.0}'
        )
        Path("blind/001.diagnosis.json").write_text(
            '{"schema": "pcalib.diagnosis/1", "verdict": "established", "established": ["backlash"], '
            '"adequate": [["backlash"]]}'
        )


def case(number: int, seed: int, folder: Path) -> Case:
    """The case with that number: what is damaged and how follows from the seed and the number alone."""
    dice = random.Random(f"{seed} {number}")
    if dice.random() < READ_SHARE:
        role = dice.choice(list(FILES))
        return Case(number, role, damaged((folder / FILES[role]).read_bytes(), dice), ())
    if dice.random() < 0.4:
        lines = [line.split() for role in corpus.COMMANDS for line in corpus.COMMANDS[role].strip().splitlines()]
        command = [word.replace("{}", FILES.get("data", "")) for word in dice.choice(lines)]
        return Case(number, "options", None, (command[0], *odd_options(command[1:], dice)))
    role = dice.choice([role for role in corpus.COMMANDS if role in FILES])
    made = Case(number, role, damaged((folder / FILES[role]).read_bytes(), dice), ())
    line = dice.choice(corpus.COMMANDS[role].strip().splitlines()).split()
    target = "blind" if role == "diagnosis" else made.name
    return Case(number, role, made.content, tuple(word.replace("{}", target) for word in line))


def attempt(made: Case, read: dict[str, Callable[[Path], Any]]) -> Outcome:
    """Run a case in the present folder."""
    if made.content is not None:
        Path(made.name).write_bytes(made.content)
    if made.argv and made.argv[1:2] and made.argv[1] in SLOW and made.number % 20 and made.content is not None:
        with contextlib.suppress(PcalibError, OSError):
            read[made.role](Path(made.name))
            return Outcome(0, "")  # it can be read, and the command would take seconds
    out, err = io.StringIO(), io.StringIO()
    code, wrong = 0, ""
    try:
        with _limited(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            if made.argv:
                code = _program(made.argv[0])(list(made.argv[1:]))
            else:
                read[made.role](Path(made.name))
    except PcalibError as error:
        code = frame.BAD_INPUT
        err.write(f"error: {error}")
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except Hang:
        wrong = "takes too long"
    except Exception as error:
        wrong = f"{type(error).__name__}: {error!s:.200}"
    said = err.getvalue()
    if not wrong and code not in (0, 1, 2):
        wrong = f"exit code {code}: {said:.300}"
    elif not wrong and code == 2 and (not said.startswith("error: ") or "Traceback" in said):
        wrong = f"no message: {said:.300}"
    elif not wrong and made.argv and ("\x1b" in said or len(said) > 20_000):
        wrong = "a message acts on the terminal, or has no end"
    return Outcome(code, wrong)


def command(
    *,
    cases: int = 50_000,
    seed: int = 0,
    start: int = 0,
    only: int | None = None,
    processes: int = 300,
    quick: Annotated[bool, Parameter(help="1,500 cases, 3 of them as processes.")] = False,
    json: frame.JsonOption = None,
) -> int:
    """Give damaged files and odd options to every reader and command.

    Args:
        cases: How many.
        seed: The same seed gives the same cases.
        start: Number of the first case, to run the attack in pieces.
        only: Run this case alone, and show it.
        processes: How many of the cases of commands run once more as processes of their own, which must agree.
    """
    if quick:
        cases, processes = min(cases, 1500), min(processes, 3)
    begun, found, failed = time.monotonic(), Counter[str](), 0
    with tempfile.TemporaryDirectory(prefix="attack-") as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        prepare(folder)
        good = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        again: list[tuple[Case, Outcome]] = []
        with contextlib.chdir(folder), frame.progress("attacking", cases) as advance:
            read = readers()
            for number in range(start, start + cases) if only is None else (only,):
                made = case(number, seed, folder)
                outcome = attempt(made, read)
                wrong = outcome.wrong or _changed(folder, good, made)
                found[f"exit {outcome.code}" if not wrong else "wrong"] += 1
                if wrong:
                    failed += 1
                    print(f"case {number} ({made.role}, {shlex.join(made.argv) or 'reader'}): {wrong}", flush=True)
                if made.argv and len(again) < processes and not wrong and _portable(made):
                    again.append((made, outcome))
                if only is not None:
                    print(made)
                advance()
            for made, outcome in again:
                differs = _as_process(made, outcome)
                _changed(folder, good, made)
                if differs:
                    failed += 1
                    print(f"case {made.number} ({shlex.join(made.argv)}) as a process: {differs}", flush=True)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    seconds = time.monotonic() - begun
    frame.say(
        f"{sum(found.values())} cases in {seconds:.0f} s: {dict(sorted(found.items()))}; {len(again)} of them as "
        f"processes; {failed} wrong; {memory / 1e6:.0f} MB."
    )
    held = failed == 0 and memory <= MEMORY
    frame.write_json(json, {
        "schema": "pcbench.attack/1", "cases": sum(found.values()), "ends": dict(found), "processes": len(again),
        "wrong": failed, "memory_bytes": memory, "seconds": seconds, "held": held,
    })  # fmt: skip
    return frame.OK if held else frame.NOT_HELD


def _program(name: str) -> Callable[[Sequence[str]], int]:
    from bench import cli as pcbench
    from pcalib import cli as pcalib

    return pcalib.main if name == "pcalib" else pcbench.main


def _changed(folder: Path, good: dict[Path, bytes], made: Case) -> str:
    """Put the folder back as it was; what a case has changed that it should not have."""
    wrong = ""
    for path in sorted(folder.rglob("*"), reverse=True):
        inside = path.relative_to(folder)
        if path in good:
            if path.read_bytes() != good[path]:
                path.write_bytes(good[path])
                if str(inside) != made.name and not _may_rewrite(made, str(inside)):
                    wrong = f"{inside} was changed"
        elif path.is_dir() and not path.is_symlink():
            if not any(kept.is_relative_to(path) for kept in good):
                shutil.rmtree(path)
        else:
            if path.name.startswith(".") and path.name != ".lock":  # of a campaign, to be gone on with
                wrong = f"{inside} was left behind"
            path.unlink()
    for path, content in good.items():
        if not path.exists():
            wrong = f"{path.relative_to(folder)} is gone"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return wrong


def _may_rewrite(made: Case, name: str) -> bool:
    """'add', 'drop' and 'log' write their model anew; an odd option may name any file as an output."""
    return made.argv[1:2] in (("add",), ("drop",), ("log",)) or (made.role == "options" and name in made.argv)


def _portable(made: Case) -> bool:
    """Whether a command runs again as a process: it was not left out as a slow one, and has no NUL in its line."""
    return len(made.argv) > 1 and made.argv[1] not in SLOW and all("\0" not in word for word in made.argv)


def _as_process(made: Case, outcome: Outcome) -> str:
    if made.content is not None:
        Path(made.name).write_bytes(made.content)
    module = "pcalib.cli" if made.argv[0] == "pcalib" else "bench.cli"
    start = [sys.executable, "-c", f"import sys; from {module} import main; sys.exit(main())"]
    words = [os.fsencode(word) for word in made.argv[1:]]
    path = {"PYTHONPATH": str(Path(__file__).resolve().parents[3])}
    done = subprocess.run([*start, *words], capture_output=True, check=False, timeout=120, env=os.environ | path)
    if done.returncode != outcome.code:
        return f"exit code {done.returncode}, not {outcome.code}: {done.stderr[:300]!r}"
    return "a traceback" if b"Traceback" in done.stderr else ""


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    """Raise `Hang` in the work that goes on for too long."""

    def over(*_: object) -> None:
        raise Hang

    timers = ((signal.SIGPROF, signal.ITIMER_PROF, SECONDS), (signal.SIGALRM, signal.ITIMER_REAL, WAITING))
    before = [signal.signal(number, over) for number, _, _ in timers]
    for _, timer, seconds in timers:
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def main(argv: Sequence[str] | None = None) -> int:
    """Run the attack from a command line."""
    return frame.script("attack", command, argv)


if __name__ == "__main__":
    sys.exit(main())
