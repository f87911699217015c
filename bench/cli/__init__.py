"""The command line `pcbench`: one file of this folder is one command; :mod:`pcalib.cli.frame` says how to add one."""

from __future__ import annotations

from collections.abc import Sequence

from pcalib.cli import frame

DESCRIPTION = """The virtual robot: simulate measurements with MuJoCo, and judge what pcalib makes of them.

Exit code: 0 fine, 1 a check that was asked for did not hold, 2 bad input, 3 a fault of the program."""
EXAMPLES = """
pcbench demo
pcbench simulate truth.toml --plan rich -n 120 -o data.csv
pcbench verify m.toml data.truth.toml --tool 0,0,-300mm
pcbench campaign bench/specs/quick.toml -o out/quick
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `pcbench` with `argv` (that of the process where None); returns the exit code."""
    return frame.run(frame.app("pcbench", __name__, __path__, DESCRIPTION, EXAMPLES, argv), argv)
