"""Join measurement files: what was measured first, and what a plan asked for later.

pcalib join data.csv more.csv -o all.csv
pcalib join data.csv more.csv -o all.csv --json joined.json
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli.frame import JsonOption, RequiredOutput, say, write_json


def command(*data: Path, output: RequiredOutput, json: JsonOption = None) -> int | None:
    """Join measurement files: what was measured first, and what a plan asked for later.

    Args:
        data: Measurement files, in order.
        output: File to write, CSV or Parquet.
    """
    from pcalib.data import measurement
    from pcalib.data.joining import differences, join

    parts = [measurement.load(path) for path in data]
    joined = join(parts)
    measurement.save(output, joined)
    lost = sorted({c for part in parts for c in part.columns} - joined.columns.keys())
    note = f" Left out, as not all files have them: {', '.join(lost)}." if lost else ""
    files = f"{len(parts)} file{'s' * (len(parts) != 1)}"
    say(f"{len(joined)} row{'s' * (len(joined) != 1)} of {files} written to {output}.{note}")
    for line in differences(parts):
        say(f"- {line}")
    content = {"schema": "pcalib.join/1", "file": output, "rows": len(joined), "files": data, "left_out": lost}
    write_json(json, content)
    return None
