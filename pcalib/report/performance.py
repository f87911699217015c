"""The record of a test after ISO 9283: figures, instrument, conditions, version and hashes of the files on one page."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pcalib.iso9283 import Record
from pcalib.report.page import Bullets, NamedValues, Page, Section, SectionBlock, Table, versions
from pcalib.wording import small

POSES = ("pose", "cycles", "AP", "AP x", "AP y", "AP z", "RP", "vAP", "dAP", "dRP", "E")
DISTANCES = ("from", "to", "cycles", "AD", "AD x", "AD y", "AD z", "RD")


def pose_rows(found: Record) -> list[tuple[str, ...]]:
    """A row for each pose; a dash where a figure could not be computed."""
    n = len(found.wanted)
    nothing = np.full(n, np.nan)
    drift = found.drift or (nothing, nothing)
    beside = [nothing if a is None else a for a in (found.variation, *drift, found.exchange)]
    return [
        (
            f"P{i + 1}", str(found.poses.cycles[i]), _length(found.poses.ap[i]),
            *(_length(v) for v in found.poses.axes[i]), _length(found.poses.rp[i]), *(_length(a[i]) for a in beside),
        )
        for i in range(n)
    ]  # fmt: skip


def distance_rows(found: Record) -> list[tuple[str, ...]]:
    """A row for each pair of poses."""
    return [
        (f"P{i + 1}", f"P{j + 1}", str(d.cycles), *(_length(v) for v in (d.ad, *d.axes)), f"±{_length(d.rd)}")
        for (i, j), d in found.distances.items()
    ]


def shown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """A table without the columns that hold nothing but dashes."""
    keep = [c for c in range(len(header)) if any(row[c] != "–" for row in rows)]
    return [header[c] for c in keep], [[row[c] for c in keep] for row in rows]


def sentence(found: Record) -> str:
    """The figures that matter most."""
    ap, rp = found.poses.ap, found.poses.rp
    worst = int(np.nanargmax(ap))
    return (
        f"Pose accuracy AP is {small(float(ap[worst]), 'm')} at worst (pose P{worst + 1}), repeatability RP "
        f"{small(float(np.nanmax(rp)), 'm')}; RMS over all cycles {small(found.poses.rms, 'm')}."
    )


def page(found: Record, robot: str, conditions: Mapping[str, str], sources: Sequence[Path]) -> Page:
    """The record as a report page.

    Args:
        robot: its name.
        conditions: instrument, payload, temperature and the like, as the file states them.
        sources: the files whose hashes are recorded.
    """
    header, rows = shown(POSES, pose_rows(found))
    blocks: list[SectionBlock] = [Table(header, rows, "<" + ">" * (len(header) - 1))]
    if found.remarks:
        blocks.append(Bullets(found.remarks, "warning"))
    wanted = [(f"P{i + 1}", *(f"{1e3 * v:.3f}" for v in p)) for i, p in enumerate(found.wanted)]
    hashes = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sources}
    return Page(
        f"Pose performance of {robot} (ISO 9283)",
        sentence(found),
        [
            Section("Poses", blocks),
            Section("Distances", [Table(DISTANCES, distance_rows(found), "<<>>>>>>")]),
            Section(
                "Conditions", [NamedValues(dict(conditions)), Table(("pose", "x mm", "y mm", "z mm"), wanted, "<>>>")]
            ),
            Section("Files", [NamedValues({name: f"SHA-256 {value}" for name, value in hashes.items()})]),
        ],
        provenance=versions(),
    )


def _length(value: float) -> str:
    return "–" if not np.isfinite(value) else small(float(value), "m")
