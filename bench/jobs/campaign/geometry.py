"""How the robots of a campaign differ from the drawing: drawn from a distribution, listed one by one, or both.

    [geometry]
    distribution = "normal"            # or "uniform", of the same 1σ
    sigma_length_mm = 0.1              # every length and coordinate
    sigma_angle_deg = 0.05             # every component of a rotation vector
    errors = { l11_mm = 0.3 }          # on top, the same in every robot

    [[geometry.group]]                 # some parameters have a σ of their own; * stands for anything
    parameters = ["l*"]
    sigma_length_mm = 0.02

    [geometry]
    distribution = "listed"
    file = "measured.csv"              # one robot per row, one column per parameter: errors, l11_um, p1.x_mm, …
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from bench import truth
from pcalib import settings
from pcalib.data import table as tables
from pcalib.errors import InputError
from pcalib.robot import Robot
from pcalib.settings import Setting

DISTRIBUTIONS = ("normal", "uniform", "listed")
SIGMAS = (
    Setting("sigma_length", "length", 0.0, 0.0, 0.05, about="1σ of every length and coordinate"),
    Setting("sigma_angle", "angle", 0.0, 0.0, 0.2, about="1σ of every component of a rotation vector"),
    Setting("sigma_ratio", "ratio", 0.0, 0.0, 0.05, about="1σ of every pure number"),
)
DISTRIBUTION = Setting("distribution", "word", "normal", words=DISTRIBUTIONS, about="how errors are drawn")
_SIGMA_OF = {"m": "sigma_length", "rad": "sigma_angle", "1": "sigma_ratio"}
_APART = ("group", "errors", "file", "robots")
"""Keys of [geometry] that are no single values."""


@dataclass(frozen=True, eq=False)
class GeometryErrors:
    """The distribution of geometric errors."""

    distribution: str
    sigma: np.ndarray
    """(nk,) 1σ of each raw parameter [m, rad, 1]."""
    common: np.ndarray
    """(nk,) errors that every robot has."""
    listed: np.ndarray | None = None
    """(n, nk) errors of each robot."""

    def errors(self, replica: int, rng: np.random.Generator) -> np.ndarray:
        """(nk,) true minus nominal of robot number `replica`."""
        if self.listed is not None:
            return self.common + self.listed[replica]
        n = len(self.sigma)
        if self.distribution == "uniform":
            return self.common + self.sigma * rng.uniform(-np.sqrt(3), np.sqrt(3), n)
        return self.common + self.sigma * rng.standard_normal(n)


def load_listed(path: Path) -> list[dict[str, float]]:
    """The rows of a CSV of errors, one robot each, as its columns name them."""
    content = tables.read(path)
    numbers = {name: content.numbers(name).tolist() for name in content.columns}
    return [{name: values[row] for name, values in numbers.items()} for row in range(len(content))]


def read(table: Mapping[str, Any], robot: Robot) -> GeometryErrors:
    """[geometry] with its groups, errors and listed robots.

    Raises:
        InputError: a key or value that cannot be used.
    """
    known = (DISTRIBUTION, *SIGMAS)
    values = settings.read({k: v for k, v in table.items() if k not in _APART}, known, "geometry", {})
    common = truth.listed_errors(robot, table.get("errors", {}))
    sigma = np.array([values[_SIGMA_OF[unit]] for unit in robot.mechanism.units])
    for i, value in _grouped(table.get("group", []), robot).items():
        sigma[i] = value
    if (values["distribution"] == "listed") != ("robots" in table):
        raise InputError('[geometry] distribution = "listed" and file = "…" go together', column="distribution")
    if "robots" not in table:
        return GeometryErrors(values["distribution"], sigma, common)
    if sigma.any():
        raise InputError('[geometry] distribution = "listed" draws nothing: leave out the σ', column="distribution")
    listed = np.array([truth.listed_errors(robot, row) for row in table["robots"]])
    return GeometryErrors("listed", sigma, common, listed)


def _grouped(groups: Any, robot: Robot) -> dict[int, float]:
    """Index of a parameter → its own 1σ, from [[geometry.group]]; later groups win."""
    if not isinstance(groups, list) or not all(isinstance(group, dict) for group in groups):
        raise InputError("[geometry] 'group' must be written as [[geometry.group]]", column="group")
    mechanism, out = robot.mechanism, {}
    for number, group in enumerate(groups, 1):
        where = f"geometry.group[{number}]"
        patterns = group.get("parameters")
        if not isinstance(patterns, list) or not patterns or not all(isinstance(p, str) for p in patterns):
            raise InputError(f"[{where}] 'parameters' must be a list of names or patterns", column="parameters")
        own = settings.read({k: v for k, v in group.items() if k != "parameters"}, SIGMAS, where, {})
        for pattern in patterns:
            chosen = [i for i, name in enumerate(mechanism.parameters) if fnmatchcase(name, pattern)]
            if not chosen:
                raise InputError(
                    f"[{where}] parameters: '{pattern}' is none of robot '{robot.name}'", column="parameters",
                    remedy=f"accepted: {', '.join(mechanism.parameters)}; * stands for anything",
                )  # fmt: skip
            out |= {i: own[_SIGMA_OF[mechanism.units[i]]] for i in chosen}
    return out
