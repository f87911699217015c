"""What a fit leaves unexplained, and the conditions under which its data were measured, as a model keeps them.

Both are needed beside the covariance of the parameters to say how far off a landing may be. A misfit that shifts the
plate adds the same to every tool; one that turns the plate grows with the tool. With covariance s²·I of the shift and
a²·I of the turn, a TCP at t from the plate's origin is off with covariance s²·I + a²·(|t|²·I − t·tᵀ).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from pcalib.errors import InputError

REMEDY = "fit the model anew, or delete the section [uncertainty]: the model then states no uncertainty"


class Beyond(StrEnum):
    """The condition of a target that lies outside the measured ones."""

    TOOL = "tool"
    PAYLOAD = "payload"
    TEMPERATURE = "temperature"
    DIRECTION = "direction"
    PLACE = "place"


TOOL_MARGIN = 10e-3
"""[m] Over such a length a turn of 1 mrad, far more than a calibrated plate has, moves the TCP by 10 µm."""
PAYLOAD_MARGIN = 0.05
"""[kg] Half a newton, which bends the softest drive of docs/bench.md (67 µrad/N·m) by 12 µrad."""
TEMPERATURE_MARGIN = 1.0
"""[K] grows an arm of 350 mm by 8 µm at most."""
PLACE_MARGIN = 0.1
"""Share of the measured span by which a place may lie outside: n uniform draws leave 1/n of it free at either end."""
TEMPERATURE = "temp"
DIRECTION = "dir"


@dataclass(frozen=True, eq=False)
class Envelope:
    """Lowest and highest value of each condition among the measured rows, (…, 2) each."""

    tool: np.ndarray
    """(3, 2) [m] plate frame."""
    payload: np.ndarray
    """(2,) [kg]."""
    place: np.ndarray
    """(3, 2) [m] plate's origin, base frame."""
    command: np.ndarray
    """(nq, 2) [rad or m]."""
    columns: Mapping[str, np.ndarray]
    """(2,) each: temperatures [°C] by name, and directions dir1 …"""

    @classmethod
    def of(
        cls, tool: np.ndarray, payload: np.ndarray, place: np.ndarray, q: np.ndarray, columns: Mapping[str, np.ndarray]
    ) -> Envelope:
        """That of N rows: tool (N, 3), payload (N,), place (N, 3), commands (N, nq), further columns (N,)."""
        kept = {name: _span(v) for name, v in columns.items() if name.startswith((TEMPERATURE, DIRECTION))}
        return cls(_span(tool), _span(payload), _span(place), _span(q), kept)

    def beyond(
        self, tool: np.ndarray, payload: np.ndarray, place: np.ndarray, q: np.ndarray, columns: Mapping[str, np.ndarray]
    ) -> dict[Beyond, np.ndarray]:
        """(N,) bool for each condition: whether a row lies outside of what was measured."""
        no = np.zeros(len(q), bool)
        out = {
            Beyond.TOOL: _outside(tool, self.tool, TOOL_MARGIN).any(axis=1),
            Beyond.PAYLOAD: _outside(payload, self.payload, PAYLOAD_MARGIN),
            Beyond.TEMPERATURE: no,
            Beyond.DIRECTION: no,
            Beyond.PLACE: _outside(place, self.place, PLACE_MARGIN * np.ptp(self.place, axis=1)).any(axis=1)
            | _outside(q, self.command, PLACE_MARGIN * np.ptp(self.command, axis=1)).any(axis=1),
        }
        for name, values in columns.items():
            if name.startswith(TEMPERATURE):
                span = self.columns.get(name)
                off = ~no if span is None else _outside(values, span, TEMPERATURE_MARGIN)
                out[Beyond.TEMPERATURE] = out[Beyond.TEMPERATURE] | off
            elif name.startswith(DIRECTION) and name[len(DIRECTION) :].isdigit():
                span = self.columns.get(name, np.zeros(2))
                out[Beyond.DIRECTION] = out[Beyond.DIRECTION] | (_outside(values, span, 0.0) & (values != 0))
        return out


def _span(values: np.ndarray) -> np.ndarray:
    return np.stack([np.nanmin(values, axis=0), np.nanmax(values, axis=0)], axis=-1)


def _outside(values: np.ndarray, span: np.ndarray, margin: np.ndarray | float) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return np.asarray((values < span[..., 0] - margin) | (values > span[..., 1] + margin))


@dataclass(frozen=True, eq=False)
class Unexplained:
    """What a fit leaves beyond the noise, and where that was seen."""

    shift: float
    """[m] standard deviation of a component of the plate's displacement."""
    turn: float
    """[rad] standard deviation of a component of the plate's rotation."""
    rows: int
    """Number of rows from which this was found: each was predicted by a fit without it."""
    inside: int
    """Number of these rows that lie inside of what was predicted for them."""
    held_out: int
    """Number of these rows that the user held out; the others were left out one by one."""
    measured: Envelope
    rivals: tuple[Mapping[str, Any], ...] = ()
    """Other explanations of the same data, as history entries of model files, each with its `weight` by evidence."""

    def covariance(self, arm: np.ndarray) -> np.ndarray:
        """(N, 3, 3) [m²] covariance, base frame, of what is unexplained at TCPs `arm` (N, 3) [m] off the plate."""
        outer = arm[:, :, None] * arm[:, None, :]
        length2 = np.einsum("ni,ni->n", arm, arm)[:, None, None]
        return self.shift**2 * np.eye(3) + self.turn**2 * (length2 * np.eye(3) - outer)

    def to_table(self) -> dict[str, Any]:
        """The section [uncertainty] of a model file."""
        m = self.measured
        return {
            "shift_um": _short(self.shift * 1e6),
            "turn_urad": _short(self.turn * 1e6),
            "rows": self.rows,
            "inside": self.inside,
            "held_out": self.held_out,
            "measured": {
                "tool_m": m.tool.tolist(),
                "payload_kg": m.payload.tolist(),
                "place_m": m.place.tolist(),
                "command_si": m.command.tolist(),
                "columns": {name: span.tolist() for name, span in m.columns.items()},
            },
            "rivals": [dict(rival) for rival in self.rivals],
        }

    @classmethod
    def from_table(cls, table: Mapping[str, Any], actuators: int) -> Unexplained:
        """What the section [uncertainty] of a model file holds.

        Raises:
            InputError: something is missing, or is no number of the kind that belongs there.
        """
        measured, rivals = table.get("measured"), table.get("rivals", [])
        if not isinstance(measured, Mapping) or not isinstance(measured.get("columns", {}), Mapping):
            raise InputError("uncertainty: 'measured' is missing, or is no table", remedy=REMEDY)
        if not isinstance(rivals, list) or not all(isinstance(r, Mapping) and "weight" in r for r in rivals):
            raise InputError("uncertainty: 'rivals' is no list of tables with a weight", remedy=REMEDY)
        for rival in rivals:
            if not 0 <= _numbers(rival, "weight", ()).item() <= 1:
                raise InputError("uncertainty: the weight of a rival is not between 0 and 1", remedy=REMEDY)
        sizes = [_numbers(table, name, ()).item() for name in ("shift_um", "turn_urad")]
        counts = [_numbers(table, name, ()).item() for name in ("rows", "inside", "held_out")]
        if min(*sizes, *counts) < 0:
            raise InputError("uncertainty: a size or a count is negative", remedy=REMEDY)
        columns = measured.get("columns", {})
        envelope = Envelope(
            _numbers(measured, "tool_m", (3, 2)),
            _numbers(measured, "payload_kg", (2,)),
            _numbers(measured, "place_m", (3, 2)),
            _numbers(measured, "command_si", (actuators, 2)),
            {str(name): _numbers(columns, name, (2,)) for name in columns},
        )
        rows, inside, held = (int(n) for n in counts)
        return cls(1e-6 * sizes[0], 1e-6 * sizes[1], rows, inside, held, envelope, tuple(rivals))


def _numbers(table: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray:
    try:
        values = np.array(table.get(key), float)
    except (TypeError, ValueError, OverflowError):
        values = np.array(np.nan)
    if values.shape != shape or not (np.abs(values) < 1e12).all():
        what = "a number" if not shape else f"{' by '.join(map(str, shape))} numbers"
        raise InputError(f"uncertainty: {key} must be {what}", remedy=REMEDY)
    return values


def _short(value: float) -> float:
    return float(f"{value:.6g}")
