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
                remedy = f"where both are, write '# frame = {a}' above its header" if what == "measuring frame" else ""
                raise InputError(f"{what} {a} and {b} do not go together", file=part.source, remedy=remedy)
    names = {name for part in parts for name in part.columns}
    everywhere = [n for n in sorted(names) if all(n in part.columns for part in parts) or n.startswith("dir")]
    columns = {
        n: np.concatenate([np.asarray(part.columns.get(n, np.zeros(len(part)))) for part in parts]) for n in everywhere
    }
    shift, ids = 0, []
    for part in parts:
        ids.append(np.where(part.pose_id >= 0, part.pose_id + shift, -1))
        shift += int(part.pose_id.max(initial=-1)) + 1
    parts = _with_sigma(parts)
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
        sigma_scale=max(part.sigma_scale for part in parts),
        sigma_target=max(part.sigma_target for part in parts),
        rounds=sum(part.rounds for part in parts),
        correlation=None if independent else np.concatenate(correlation),
        instrument=first.instrument if all(each == told[0] for each in told) else None,
        readings=Readings.joined([part.readings for part in parts], [len(part) for part in parts]),
    )


def _with_sigma(parts: Sequence[Measurements]) -> list[Measurements]:
    """The parts, with the median stated σ given to readings whose file states none."""
    out = list(parts)
    for i in (0, 1):
        block = slice(3 * i, 3 * i + 3)
        known = [part.sigma[:, block] for part in parts if part.stated[i] and part.kinds[i]]
        if not known:
            continue
        usual = float(np.median(np.concatenate(known)))
        for n, part in enumerate(out):
            if part.kinds[i] and not part.stated[i]:
                sigma = part.sigma.copy()
                sigma[:, block] = usual
                stated = (True, part.stated[1]) if i == 0 else (part.stated[0], True)
                out[n] = replace(part, sigma=sigma, stated=stated)
    return out


def differences(parts: Sequence[Measurements]) -> list[str]:
    """Differences between the metadata of the files, one sentence each."""
    out, first = [], parts[0]
    for part in parts[1:]:
        if part.euler != first.euler and part.turned.any() and first.turned.any():
            ways = [f"Euler angles {p.euler}" if p.euler else "rotation vectors or quaternions" for p in (first, part)]
            out.append(f"{first.source} has {ways[0]}, and {part.source} {ways[1]}: each is read as its file says.")
    for i, what in enumerate(("positions", "rotations")):
        silent = [part.source for part in parts if part.kinds[i] and not part.stated[i]]
        if silent and any(part.stated[i] and part.kinds[i] for part in parts):
            out.append(f"{', '.join(silent)} states no σ of {what}: that of the other rows is taken.")
    return out
