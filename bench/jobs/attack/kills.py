"""Kill commands again and again, and compare everything that they write in the end with what one left alone writes.

    scripts/kills --kills 100

Each time everything, the main process alone, or one of its workers gets SIGKILL at a random moment: while workers
start, while they are at work, while files are written. After that nothing of the command may run any more within five
seconds, no result may be incomplete, and the same command, given again, ends with the same bytes and leaves
nothing else.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.jobs.attack.corpus import TRUTH
from pcalib.cli import frame

ROOT = Path(__file__).parents[3]
PROGRAM = "import sys; from {}.cli import main; sys.exit(main())"
MARK = "PCALIB_KILLED"
"""Variable of the environment by which all processes of a command are known."""
GRACE = 5.0
"""[s] within which nothing of a killed command may run any more."""
AGAIN = 5
"""Kills after which a command that always begins anew may run to its end."""
LONGEST = 600.0
"""[s] Longest time that a command may take which is not killed."""

SPEC = """\
name = "killed"
robot = "delta"
robots = 24
seed = 3
[geometry]
sigma_length_mm = 0.1
sigma_angle_deg = 0.05
[verify]
targets = 50
[output]
part_robots = 2
"""


@dataclass(frozen=True)
class Victim:
    """A command that is killed."""

    words: str
    """Words of its command line; the first one is the program."""
    workers: bool = False
    """Whether its worker processes are killed by themselves too."""
    onwards: bool = False
    """Whether it goes on where it was killed, instead of beginning anew."""
    once: bool = False
    """Whether it refuses to write what is already there."""
    done: Callable[[Path], bool] | None = None
    """Whether a program that never ends by itself has done its work in this folder."""


def _window_is_done(folder: Path) -> bool:
    try:
        record = json.loads((folder / "session" / "session.json").read_bytes())
    except (FileNotFoundError, ValueError):
        return False
    return bool(record["steps"]) and not record["pending"]


VICTIMS = {
    "campaign": Victim("bench campaign spec.toml -o out --workers 2", workers=True, onwards=True),
    "simulate": Victim("bench simulate truth.toml --plan rich -n 400 -o data.csv --workers 2 --json said.json", True),
    "blind": Victim("bench blind -n 6 -o out --workers 2", workers=True, once=True),
    "demo": Victim("bench demo --poses 20 --spacing 300mm -o out --json said.json"),
    "workbench": Victim(
        "pcalib workbench rows.csv --robot robot.toml --folder session --no-browser", onwards=True, done=_window_is_done
    ),
}  # fmt: skip


def _may_be_interrupted() -> None:
    """Let Ctrl-C reach a program although this one was started in the background, where shells ignore it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def command(
    *, kills: int = 100, seed: int = 0, only: str | None = None, quick: bool = False, json: frame.JsonOption = None
) -> int:
    """Kill commands again and again, and compare what they write in the end with what one left alone writes.

    Args:
        kills: How many, shared among the commands.
        seed: Seed of the random moments.
        only: One command: campaign, simulate, blind, demo or workbench.
        quick: 5 kills, one of each.
    """
    names = list(VICTIMS) if only is None else [only]
    if not set(names) <= set(VICTIMS):
        frame.fail(f"'{only}' cannot be killed here; these are the commands that can: {', '.join(VICTIMS)}")
        return frame.BAD_INPUT
    kills = len(names) if quick else kills
    wrong: list[str] = []
    figures = {}
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        for i, victim in enumerate(names):
            count = kills // len(names) + (i < kills % len(names))
            found = _Place(Path(name) / victim, VICTIMS[victim], random.Random(f"{seed} {victim}")).torment(count)
            told = ", ".join(f"{count} of {what}" for what, count in sorted(found.of.items()))
            frame.say(f"{victim}: {told}; {found.ends} ends compared; {len(found.wrong)} wrong")
            figures[victim] = {"kills": dict(found.of), "ends": found.ends, "wrong": found.wrong}
            wrong += [f"{victim}: {what}" for what in found.wrong]
    for what in wrong:
        frame.say(what)
    content = {"schema": "pcbench.kills/1", "seed": seed, "commands": figures, "held": not wrong}
    frame.write_json(json, content)
    return frame.NOT_HELD if wrong else frame.OK


@dataclass
class _Found:
    """What kills of a command have shown."""

    of: Counter[str]
    """How often everything, the main process or a worker was killed."""
    ends: int
    wrong: list[str]


class _Place:
    """A command in a folder of its own, with a folder for its temporary files."""

    def __init__(self, folder: Path, victim: Victim, dice: random.Random):
        self.folder, self.victim, self.dice = folder, victim, dice
        self.mark = f"{os.getpid()}-{folder.name}"
        self.found = _Found(Counter(), 0, [])

    def torment(self, kills: int) -> _Found:
        """Kill the command so many times; it runs to its end now and then, and at last."""
        memory = _shared_memory()
        self._begin()
        begun = time.monotonic()
        code, _ = self._run(None)
        alone = time.monotonic() - begun
        whole = _content(self.folder)
        if code != 0:
            self.found.wrong.append(f"ends with {code} when it is left alone")
            return self.found
        self._begin()
        since = 0
        while self.found.of.total() < kills:
            code, what = self._run(self.dice.uniform(0.0, 1.1 * alone))
            if what and code < 0:
                self.found.of[what] += 1
                since += 1
                self._no_halves(whole)
            elif code != 0:
                self.found.wrong.append(f"kill of {what or 'nothing'}: exit code {code}")
                self._begin()
            elif what:
                self.found.of[what] += 1
            there = _content(self.folder).keys() >= whole.keys()
            if code == 0 or (self.victim.once and there):
                self._compare(whole)
            elif not self.victim.onwards and since >= AGAIN:
                self._end(whole)
                since = 0
        self._end(whole)
        self.found.wrong += [f"/dev/shm/{name} is left" for name in sorted(_shared_memory() - memory)]
        return self.found

    def _end(self, whole: dict[str, bytes]) -> None:
        """Let the command run to its end, and compare what it wrote."""
        if not (self.victim.once and _content(self.folder).keys() >= whole.keys()):
            code, _ = self._run(None)
            if code != 0:
                self.found.wrong.append(f"ends with {code} after kills")
        self._compare(whole)

    def _begin(self) -> None:
        """The folder as it is before the command."""
        shutil.rmtree(self.folder, ignore_errors=True)
        (self.folder / "tmp").mkdir(parents=True)
        (self.folder / "spec.toml").write_text(SPEC)
        (self.folder / "truth.toml").write_text(TRUTH)
        example = ROOT / "pcalib" / "workbench" / "example"
        shutil.copy(example / "robot.toml", self.folder)
        shutil.copy(example / "data.csv", self.folder / "rows.csv")

    def _run(self, patience: float | None) -> tuple[int, str]:
        """Run the command, killed after `patience` [s]; its return code, and what was killed."""
        program, *words = self.victim.words.split()
        limit, what = time.monotonic() + (LONGEST if patience is None else patience), ""
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(program), *words], cwd=self.folder, start_new_session=True,
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": str(ROOT), MARK: self.mark, "TMPDIR": str(self.folder / "tmp")},
            preexec_fn=_may_be_interrupted,
        )  # fmt: skip
        while process.poll() is None:
            if self.victim.done is not None and self.victim.done(self.folder):
                process.send_signal(signal.SIGINT)
                process.wait(GRACE)
                self._nothing_runs("Ctrl-C")
                return 0, what
            if time.monotonic() > limit:
                what = self._kill(process)
                limit = time.monotonic() + LONGEST
            time.sleep(0.005)
        self._nothing_runs(what or "an end by itself")
        return process.returncode, what

    def _kill(self, process: subprocess.Popen[bytes]) -> str:
        """Kill one process of the command, or all of them; returns which."""
        others = [one for one in self._running() if one != process.pid]
        kinds = ["everything", "the main process", *(["a worker"] if self.victim.workers and others else [])]
        what = self.dice.choice(kinds)
        if what == "everything":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            os.kill(process.pid if what == "the main process" else self.dice.choice(others), signal.SIGKILL)
        return what

    def _running(self) -> list[int]:
        """Processes of the command."""
        mark, found = f"{MARK}={self.mark}".encode(), []
        for entry in Path("/proc").iterdir():
            try:
                if entry.name.isdigit() and mark in (entry / "environ").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
            except OSError:
                continue  # it has ended, or is somebody else's
        return sorted(found)

    def _nothing_runs(self, after: str) -> None:
        limit = time.monotonic() + GRACE
        while left := self._running():
            if time.monotonic() > limit:
                self.found.wrong.append(f"after {after}, {len(left)} processes run on")
                for one in left:
                    os.kill(one, signal.SIGKILL)
                return
            time.sleep(0.05)

    def _no_halves(self, whole: dict[str, bytes]) -> None:
        """Check that no result is there in part. The workbench's record and recordings differ from run to run."""
        for name, content in _content(self.folder).items():
            if name in whole and not name.endswith((".rrd", "session.json")) and content != whole[name]:
                self.found.wrong.append(f"{name} is incomplete")

    def _compare(self, whole: dict[str, bytes]) -> None:
        """Compare the folder with that of a run without kills, and empty it for the next run."""
        ended = _content(self.folder)
        self.found.ends += 1
        self.found.wrong += [f"{name} is left behind" for name in sorted(ended.keys() - whole.keys())]
        self.found.wrong += [f"{name} is not there" for name in sorted(whole.keys() - ended.keys())]
        for name in sorted(whole.keys() & ended.keys()):
            same = _same_recording if name.endswith(".rrd") else bytes.__eq__
            if not same(whole[name], ended[name]):
                self.found.wrong.append(f"{name} has other bytes")
        self._begin()


def _content(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones and those in the folder for temporary files included."""
    found = {}
    for path in folder.rglob("*"):
        if path.is_file():
            found[str(path.relative_to(folder))] = path.read_bytes()
        elif not any(path.iterdir()) and path != folder / "tmp":
            found[f"{path.relative_to(folder)}/"] = b""
    return found


def _same_recording(one: bytes, other: bytes) -> bool:
    """Whether two recordings say the same; Rerun numbers their chunks and rows by the clock."""
    with tempfile.TemporaryDirectory() as name:
        for file, content in (("one.rrd", one), ("other.rrd", other)):
            (Path(name) / file).write_bytes(content)
        words = ["-m", "rerun", "rrd", "compare", "--unordered", "one.rrd", "other.rrd"]
        return subprocess.run([sys.executable, *words], cwd=name, check=False, capture_output=True).returncode == 0


def _shared_memory() -> set[str]:
    place = Path("/dev/shm")
    return {path.name for path in place.iterdir()} if place.is_dir() else set()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return frame.script("kills", command, argv)


if __name__ == "__main__":
    sys.exit(main())
