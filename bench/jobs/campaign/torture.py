"""Kill a campaign again and again, and compare its results with those of an uninterrupted campaign.

    scripts/campaign_torture --kills 20

Each time the whole process group, or the main process alone, gets SIGKILL at a random moment: while workers start,
while robots are at work, while parts are written, while the results are put together.
"""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from pcalib.cli import frame

SPEC = """
name = "torture"
robot = "delta"
robots = {robots}
seed = 3
[geometry]
sigma_length_mm = 0.1
sigma_angle_deg = 0.05
[verify]
targets = 50
[output]
part_robots = 2
"""
COMMAND = [sys.executable, "-c", "import sys; from bench.cli import main; sys.exit(main())", "campaign"]
ROOT = Path(__file__).parents[3]


def command(*, kills: int = 20, robots: int = 120, quick: bool = False, seed: int = 0) -> int:
    """Kill a campaign again and again, and compare its results, byte by byte, with those of an uninterrupted one.

    Args:
        kills: How often it is killed.
        robots: Size of the campaign.
        quick: 3 kills of 24 robots, to see that everything runs.
        seed: Seed of the random moments.
    """
    if quick:
        kills, robots = 3, 24
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="torture-") as name:
        folder = Path(name)
        (folder / "spec.toml").write_text(SPEC.format(robots=robots))
        begun = time.monotonic()
        whole, _ = _run(folder, "whole", None, rng)
        assert whole == 0
        alone = time.monotonic() - begun
        print(f"uninterrupted: {alone:.1f} s, {_digest(folder / 'whole')[:16]}", flush=True)
        done, runs = 0, 0
        while True:
            runs += 1
            # Some moments lie anywhere from the start, most of them after the first part that this run has finished.
            patience = rng.uniform(0.0, alone / 5) if done < kills else None
            code, what = _run(folder, "killed", patience, rng, after_a_part=rng.random() < 0.8)
            finished = (folder / "killed" / "results.parquet").exists()
            if code == 0 and patience is not None:  # it got through before: begin once more, kills are still to be had
                same = _digest(folder / "killed") == _digest(folder / "whole")
                print(f"ended between kills, {'the same bytes' if same else 'OTHER BYTES'}; once more", flush=True)
                if not same:
                    return 1
                shutil.rmtree(folder / "killed")
                continue
            if code == 0:
                break
            done += 1
            state = "results are there" if finished else f"{_parts(folder / 'killed')} of {robots // 2} parts are there"
            print(f"kill {done} of {what}: {state}", flush=True)
        same = _digest(folder / "killed") == _digest(folder / "whole")
        print(f"{done} kills in {runs} runs: {'byte-identical' if same else 'OTHER BYTES'}")
        return 0 if same else 1


def _run(
    folder: Path, name: str, patience: float | None, rng: random.Random, after_a_part: bool = False
) -> tuple[int, str]:
    """Run the campaign, killed `patience` [s] after its start or its first part; return code, and what was killed."""
    command = [*COMMAND, str(folder / "spec.toml"), "-o", str(folder / name), "--no-figures"]
    had = _parts(folder / name)
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    what = "everything" if rng.random() < 0.5 else "the main process"
    while patience is not None and after_a_part and process.poll() is None and _parts(folder / name) <= had:
        time.sleep(0.002)
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        (os.killpg if what == "everything" else os.kill)(process.pid, signal.SIGKILL)
        process.wait()
    return process.returncode, what


def _parts(folder: Path) -> int:
    return len(list((folder / "parts").glob("[0-9]*.parquet")))


def _digest(folder: Path) -> str:
    return hashlib.sha256((folder / "results.parquet").read_bytes()).hexdigest()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return frame.script("campaign_torture", command, argv)


if __name__ == "__main__":
    sys.exit(main())
