"""Several measurement files as one: what was measured first, and what a plan asked for later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.data.readings import Readings
from pcalib.errors import InputError


def join(parts: Sequence[Measurements]) -> Measurements:
    """The rows of all files, in order.

    Ids of replicates are kept apart between files. A column that some file lacks is left out, except directions,
    which are 0 where they were not recorded. Times are taken to be of one clock.

    Raises:
        InputError: nothing to join, or files of different robots, actuators or measuring frames.
    """
    if not parts:
        raise InputError("no measurement files to join")
    first = parts[0]
    for part in parts[1:]:
        for what, a, b in (
            ("actuators", first.actuators, part.actuators),
            ("measuring frame", first.frame, part.frame),
            ("robot", first.robot_name or part.robot_name, part.robot_name or first.robot_name),
        ):
            if a != b:
                raise InputError(f"{what} {a} and {b} do not go together", file=part.source)
    names = {name for part in parts for name in part.columns}
    everywhere = [n for n in sorted(names) if all(n in part.columns for part in parts) or n.startswith("dir")]
    columns = {
        n: np.concatenate([np.asarray(part.columns.get(n, np.zeros(len(part)))) for part in parts]) for n in everywhere
    }
    shift, ids = 0, []
    for part in parts:
        ids.append(np.where(part.pose_id >= 0, part.pose_id + shift, -1))
        shift += int(part.pose_id.max(initial=-1)) + 1
    one = ("q", "position", "rotation", "mask", "tool", "payload", "check", "sigma", "lines")
    independent = all(part.correlation is None for part in parts)
    correlation = [np.tile(np.eye(6), (len(p), 1, 1)) if p.correlation is None else p.correlation for p in parts]
    told = [part.instrument.metadata(part.frame) if part.instrument else {} for part in parts]
    return replace(
        first,
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in one},
        columns=columns,
        pose_id=np.concatenate(ids),
        stated=tuple(all(part.stated[i] or not part.kinds[i] for part in parts) for i in (0, 1)),
        source=" + ".join(part.source for part in parts),
        notes={},
        correlation=None if independent else np.concatenate(correlation),
        instrument=first.instrument if all(each == told[0] for each in told) else None,
        readings=Readings.joined([part.readings for part in parts], [len(part) for part in parts]),
    )
