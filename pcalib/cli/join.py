"""Join measurement files: what was measured first, and what a plan asked for later.

pcalib join data.csv more.csv -o all.csv
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli.frame import RequiredOutput, say


def command(*data: Path, output: RequiredOutput) -> int | None:
    """Join measurement files: what was measured first, and what a plan asked for later.

    Args:
        data: Measurement files, in order.
        output: File to write, CSV or Parquet.
    """
    from pcalib.data import measurement
    from pcalib.data.joining import join

    parts = [measurement.load(path) for path in data]
    joined = join(parts)
    measurement.save(output, joined)
    lost = sorted({c for part in parts for c in part.columns} - joined.columns.keys())
    note = f" Left out, as not all files have them: {', '.join(lost)}." if lost else ""
    say(f"{len(joined)} rows of {len(parts)} files written to {output}.{note}")
    return None
