"""What the controller asks of the robot, row by row, and where the robot ends up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pcalib.errors import InputError

TEMPERATURES = ("arms", "rods", "base")
REFERENCE_TEMPERATURE = 20.0
"""[°C] at which the robot has its written dimensions."""


@dataclass(frozen=True)
class Row:
    """One command and the state of the world in which it is carried out."""

    index: int
    """Number of the row in the plan, from 0."""
    q: np.ndarray
    """(nq,) commanded actuator values, what the encoders read [rad or m]."""
    tool: np.ndarray
    """(3,) [m] TCP in the plate frame; the payload hangs there."""
    payload: float
    """[kg]."""
    columns: Mapping[str, float]

    def direction(self, actuator: int) -> float:
        """Return the sign of the actuator's last motion: −1, 0, +1; 0 where it is not given."""
        return float(np.sign(self.columns.get(f"dir{actuator + 1}", 0.0)))

    def warming(self, part: str) -> float:
        """Return the temperature [K] of 'arms', 'rods' or 'base' above 20 °C."""
        return self.columns[f"temp_{part}"] - REFERENCE_TEMPERATURE

    @property
    def time(self) -> float:
        """[s] since the first row."""
        return self.columns["time"]


@dataclass(frozen=True)
class Commands:
    """N rows of commands; further columns, all (N,): temp_arms temp_rods temp_base [°C], time [s], dir1 …"""

    q: np.ndarray
    """(N, nq) [rad or m]."""
    tool: np.ndarray
    """(N, 3) [m], plate frame."""
    payload: np.ndarray
    """(N,) [kg]."""
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    index: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    """(N,) numbers of the rows in the plan; 0, 1, … where they are not given."""

    def __post_init__(self) -> None:
        if len(self.index) != len(self.q):
            object.__setattr__(self, "index", np.arange(len(self.q)))

    @classmethod
    def of(
        cls,
        q: np.ndarray,
        tool: np.ndarray | float = 0.0,
        payload: np.ndarray | float = 0.0,
        **columns: np.ndarray | float,
    ) -> Commands:
        """Return commands from actuator values (N, nq); tool and payload are common or one per row."""
        q = np.atleast_2d(np.asarray(q, float))
        n = len(q)
        return cls(
            q,
            np.broadcast_to(np.asarray(tool, float), (n, 3)).copy(),
            np.broadcast_to(np.asarray(payload, float), (n,)).copy(),
            {name: np.broadcast_to(np.asarray(v, float), (n,)).copy() for name, v in columns.items()},
        )

    def __len__(self) -> int:
        return len(self.q)

    def __iter__(self) -> Iterator[Row]:
        for n in range(len(self)):
            yield Row(
                int(self.index[n]), self.q[n], self.tool[n], float(self.payload[n]),
                {c: float(v[n]) for c, v in self.columns.items()},
            )  # fmt: skip

    def take(self, rows: np.ndarray | slice) -> Commands:
        """Return some of the rows."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return Commands(self.q[rows], self.tool[rows], self.payload[rows], columns, self.index[rows])

    def remembering(self, columns: Mapping[str, np.ndarray]) -> Commands:
        """Return the commands with further columns; columns that they have already stay as they are."""
        return replace(self, columns={**columns, **self.columns}) if columns else self

    def need(self, columns: tuple[str, ...], who: str) -> None:
        """Check that columns are present and hold numbers.

        Raises:
            InputError: names the absent column and what to add.
        """
        for name in columns:
            if name not in self.columns or not np.isfinite(self.columns[name]).all():
                what = "temperature history" if name.startswith("temp_") else "column"
                raise InputError(
                    f"{who} needs a {what} '{name}', which these commands do not have (or not for every row)",
                    remedy="use a plan that has it (--plan rich), give it in the CSV of the plan, or drop the fault",
                )


@dataclass(frozen=True)
class Landing:
    """Where the robot stands for N commands, in the base frame (the measuring frame of an ideal instrument)."""

    x: np.ndarray
    """(N, 3) [m] plate position; NaN where the status is not 'ok'."""
    R: np.ndarray
    """(N, 3, 3) plate orientation."""
    tcp: np.ndarray
    """(N, 3) [m] tool centre point."""
    status: np.ndarray
    """(N,) of 'ok', 'not_converged', 'wrong_branch', 'joint_limit'."""

    @property
    def ok(self) -> np.ndarray:
        """(N,) bool."""
        return self.status == "ok"

    def __len__(self) -> int:
        return len(self.x)

    def take(self, rows: np.ndarray | slice) -> Landing:
        """Return some of the rows."""
        return Landing(self.x[rows], self.R[rows], self.tcp[rows], self.status[rows])
