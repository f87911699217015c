"""Outputs that have no room; tests/cli/test_outputs.py tries those that have no place."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

WRITERS = """
    pcalib inspect data.csv --json {}
    pcalib fit data.csv --robot robot.toml -o {}
    pcalib compare data.csv --model m.toml --report {}
    pcalib compare data.csv --model m.toml --rrd {}
    pcalib diagnose data.csv --model m.toml --report {}
    pcalib explain backlash data.csv --model m.toml --plot {}.svg
    pcalib add backlash data.csv --model m.toml -o {}
    pcalib next data.csv --model m.toml --between backlash,nothing -n 2 -o {}
    pcalib log m.toml --back-to 1 -o {}
    pcalib compensate targets.csv --model m.toml -o {}
    pcalib view m.toml --save {}
    pcalib plan --robot robot.toml -n 8 -o {}
    pcalib join data.csv plan.csv -o {}
    pcalib firmware printer.toml --dialect klipper -o {}
    pcbench simulate truth.toml -n 4 -o {}
    pcbench verify m.toml truth.toml --json {}
    pcbench blind -n 1 -o {}
    pcbench campaign spec.toml --workers 1 -o {}
    pcbench demo -o {}
"""
WRITERS = [line.strip() for line in WRITERS.strip().splitlines()]


def test_a_full_disk(cell, tmp_path):
    """Files may grow to 2 kB only: every command that writes more says so, and leaves nothing."""
    code = """
        import os, resource, signal, sys
        from pcalib import cli as pcalib
        from bench import cli as pcbench
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        for line in sys.stdin.read().splitlines():
            program, *arguments = line.split()
            resource.setrlimit(resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))
            before = sorted(os.listdir("."))
            code = (pcalib if program == "pcalib" else pcbench).main(arguments)
            left = [f for f in os.listdir(".") if f not in before]
            print("END", code, left, flush=True)
    """
    small = "demo|log|next|compen|inspect|join|-n 8|verify|firm"  # what they write has room
    asked = [argv.replace("{}", "new") for argv in WRITERS if not re.search(small, argv)]
    asked.append("pcalib join data.csv again.csv -o new.parquet")
    shutil.copy(cell / "data.csv", cell / "again.csv")
    # Python would leave halves of compiled modules in the project, Matplotlib its cache of fonts among the results.
    own = {"PYTHONDONTWRITEBYTECODE": "1", "HOME": str(tmp_path), "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=cell, input="\n".join(asked), capture_output=True, text=True,
        env={"PATH": "/usr/bin:/bin", **own}, timeout=200, check=False,
    )  # fmt: skip
    ends = [line for line in done.stdout.splitlines() if line.startswith("END")]
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    # A campaign keeps what it has, to go on from there.
    assert ends == ["END 2 ['new']" if "campaign" in argv else "END 2 []" for argv in asked], done
    assert not [f for f in (cell / "new").rglob("*") if f.suffix == ".parquet" or f.name.startswith(".campaign")]
    shutil.rmtree(cell / "new")
    assert len(errors) == len(asked) and "Traceback" not in done.stderr, done.stderr
    assert all("cannot" in line for line in errors), errors


def test_from_the_shell(cell):
    """The installed programs say the same: exit code 2, one message on stderr."""
    for program, argv in (
        ("pcalib", "fit absent.csv --robot robot.toml"),
        ("pcalib", "fitt data.csv"),
        ("pcbench", "simulate absent.toml -o new.csv"),
    ):
        path = Path(sys.executable).parent / program
        if not path.exists():
            pytest.skip("not installed beside this Python")
        done = subprocess.run([path, *argv.split()], cwd=cell, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and done.stdout == "", done
        assert done.stderr.startswith("error: ") and "Traceback" not in done.stderr
