"""The command line `pcalib`: one file of this folder is one command; :mod:`pcalib.cli.frame` says how to add one."""

from __future__ import annotations

from collections.abc import Sequence

from pcalib.cli import frame

DESCRIPTION = """Calibrate parallel robots: identify every rod, compensate the command, find the missing physics.

Files: robots are TOML, measurements and targets CSV or Parquet; every quantity carries its unit in its name.
Exit code: 0 fine, 1 a check that was asked for did not hold, 2 bad input, 3 a fault of the program."""
EXAMPLES = """
pcalib inspect data.csv --robot models/delta.toml
pcalib fit data.csv --robot models/delta.toml -o m.toml
pcalib diagnose data.csv --model m.toml
pcalib compensate targets.csv --model m.toml --tool 0,0,-300mm -o commands.csv
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `pcalib` with `argv` (that of the process where None); returns the exit code."""
    return frame.run(frame.app("pcalib", __name__, __path__, DESCRIPTION, EXAMPLES, argv), argv)
