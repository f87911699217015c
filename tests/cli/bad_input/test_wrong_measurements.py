"""Measurement files damaged in every way that people and programs damage them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from pcalib import cli as pcalib


@dataclass
class Sheet:
    """A measurement file to be damaged."""

    head: list[str]
    rows: list[list[str]]
    meta: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> Sheet:
        lines = path.read_text().splitlines()
        meta = [line for line in lines if line.startswith("#")]
        head, *rows = (line.split(",") for line in lines[len(meta) :])
        return cls(head, rows, meta)

    def write(self, path: Path) -> None:
        path.write_text("\n".join([*self.meta, ",".join(self.head), *map(",".join, self.rows)]) + "\n")

    def set(self, row: int, column: str, value: str) -> None:
        self.rows[row][self.head.index(column)] = value

    def name(self, **new: str) -> None:
        self.head = [new.get(name, name) for name in self.head]

    def scale(self, prefix: str, factor: float, unit: str | None = None) -> None:
        for i, name in enumerate(self.head):
            if re.fullmatch(prefix + r"_[a-z]+", name):
                self.head[i] = name if unit is None else name.rpartition("_")[0] + f"_{unit}"
                for row in self.rows:
                    row[i] = repr(float(row[i]) * factor)

    def without(self, *names: str) -> None:
        keep = [i for i, name in enumerate(self.head) if name not in names]
        self.head, self.rows = [self.head[i] for i in keep], [[row[i] for i in keep] for row in self.rows]

    def also(self, name: str, value: str) -> None:
        self.head.append(name)
        for row in self.rows:
            row.append(value)

    def quaternion(self, *values: str) -> None:
        self.without("rx_deg", "ry_deg", "rz_deg")
        for name, value in zip(("qw", "qx", "qy", "qz"), values, strict=False):
            self.also(name, value)


Q, X = r"q\d", "[xyz]"
DAMAGE: dict[str, tuple[Callable[[Sheet], object], str]] = {
    "no unit": (lambda s: s.name(x_mm="x"), r":5: column 'x' has no unit\n  write one of x_um, x_mm"),
    "unit of another dimension": (lambda s: s.name(x_mm="x_deg"), r":5: .*'deg' is not a unit of length"),
    "unit unknown": (lambda s: s.name(q1_deg="q1_grad"), r":5: .*'grad' is not a known unit"),
    "given twice": (lambda s: s.also("x_mm", "0"), r":5: column 'x_mm' is given twice"),
    "given twice in other units": (lambda s: s.also("x_m", "0"), r":5: 'x' is given twice"),
    "radians named degrees": (lambda s: s.scale(Q, np.pi / 180), "q1, q2, q3 are in radians, not degrees"),
    "degrees named radians": (lambda s: s.scale(Q, 1, "rad"), r":6: column 'q1_rad'.*outside the joint range"),
    "rotations in degrees named radians": (lambda s: s.scale("r[xyz]", 1, "rad"), "rotation is in degrees"),
    "metres named millimetres": (lambda s: s.scale(X, 1e-3), r":6: .*\n  the values look like m: name the columns x_m"),
    "millimetres named metres": (lambda s: s.scale(X, 1, "m"), r":6: .*\n  the values look like mm: name the columns"),
    "actuators swapped": (lambda s: s.name(q1_deg="q2_deg", q2_deg="q1_deg"), "q1 is what stands in q2"),
    "axes swapped": (lambda s: s.name(x_mm="y_mm", y_mm="x_mm"), "x is what stands in y"),
    "command and position swapped": (lambda s: s.name(q1_deg="x_mm", x_mm="q1_deg"), r"column 'q1_deg'|is missing|far"),
    "left-handed": (lambda s: s.scale("y", -1), "y has the wrong sign"),
    "upside down": (lambda s: s.scale("z", -1), r"far off the workspace.*\n.*sign of z"),
    "NaN": (lambda s: s.set(3, "x_mm", "nan"), r":9: column 'x_mm': 'nan' is not a finite number"),
    "infinite": (lambda s: s.set(3, "payload_kg", "inf"), r":9: column 'payload_kg': 'inf' is not a finite number"),
    "a word": (lambda s: s.set(3, "q2_deg", "home"), r":9: column 'q2_deg': 'home' is not a finite number"),
    "a decimal comma": (lambda s: s.set(3, "x_mm", "1,5"), r":9: \d+ fields where the header has \d+"),
    "a blank command": (lambda s: s.set(3, "q1_deg", ""), r":9: column 'q1_deg': the field is blank"),
    "two thirds of a rotation": (lambda s: s.without("rx_deg"), r":5: column 'rx' is missing"),
    "no such direction": (lambda s: s.set(3, "dir1", "2"), r":9: column 'dir1': '2' is no direction"),
    "no such set": (lambda s: s.set(3, "set", "maybe"), r":9: column 'set': 'maybe' is no set"),
    "negative payload": (lambda s: s.set(3, "payload_kg", "-1"), r":9: .*a payload cannot be negative"),
    "position out of the world": (lambda s: s.set(3, "x_mm", "5000"), r":9: .*far off the workspace"),
    "command out of range": (lambda s: s.set(3, "q1_deg", "80"), r":9: column 'q1_deg': 80° is outside the joint"),
    "no position": (lambda s: s.without("x_mm"), r":5: column 'x' is missing"),
    "an actuator missing": (lambda s: s.without("q3_deg"), r":5: column 'q3' is missing"),
    "an actuator too many": (lambda s: s.also("q4_deg", "0"), r":5: column 'q4_deg': there is no actuator 4"),
    "part of a rotation": (lambda s: s.without("rz_deg"), r":5: column 'rz' is missing"),
    "quaternion not of length 1": (lambda s: s.quaternion("1", "0.5", "0", "0"), r":6: .*has length 1.118.*, not 1"),
    "quaternion scalar last": (lambda s: s.quaternion("0", "0", "0", "1"), "in the order x, y, z, w"),
    "three quarters of a quaternion": (lambda s: s.quaternion("1", "0", "0"), r":5: column 'qz' is missing"),
    "σ without unit": (lambda s: s.meta.append("# sigma_pos = 1"), r":5: metadata 'sigma_pos' has no unit"),
    "σ zero": (lambda s: setattr(s, "meta", ["# sigma_pos_mm = 0"]), r":1: .*must be a positive number"),
    "metadata unknown": (lambda s: s.meta.append("# author = me"), r":5: unknown metadata key 'author'; accepted"),
    "frame unknown": (lambda s: setattr(s, "meta", ["# frame = camera"]), r":1: frame 'camera' is unknown"),
    "a short row": (lambda s: s.rows[3].pop(), r":9: \d+ fields where the header has \d+"),
    "header only": (lambda s: s.rows.clear(), r":5: there is a header but no row"),
}  # fmt: skip

@pytest.mark.parametrize("case", DAMAGE)
def test_damaged_measurements(case, cell, one_refused):
    damage, said = DAMAGE[case]
    sheet = Sheet.read(cell / "data.csv")
    assert len(sheet.meta) == 4  # the lines named above
    damage(sheet)
    sheet.write(cell / "bad.csv")
    one_refused("data", "bad.csv", said)


def test_too_few_poses(cell, refused, each_refused):
    sheet = Sheet.read(cell / "data.csv")
    for rows, said in (
        (sheet.rows[:1], "too few poses: 1 pose |1 pose leaves nothing to judge"),
        (sheet.rows[:5], "too few poses: 5 poses |[35] poses leave nothing to judge"),
        ([sheet.rows[0]] * 40, "rank deficient|1 pose"),
    ):
        Sheet(sheet.head, rows, sheet.meta).write(cell / "few.csv")
        each_refused("data", "few.csv", said, but="inspect|compare|next|join|fit")
        refused("pcalib fit few.csv --robot robot.toml -o new.toml", said, "few.csv")
    with_check = [[*row[:-1], "check"] for row in sheet.rows]
    Sheet(sheet.head, with_check, sheet.meta).write(cell / "few.csv")
    each_refused("data", "few.csv", "no rows to fit: all are set = check", but="inspect|join")


def test_the_json_of_a_fit_that_was_tried_says_how_it_ended(cell, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    sheet = Sheet.read(cell / "data.csv")
    Sheet(sheet.head, [sheet.rows[0]] * 40, sheet.meta).write(Path("few.csv"))
    assert pcalib.main(["fit", "few.csv", "--robot", f"{cell}/robot.toml", "-o", "m.toml", "--json", "why.json"]) == 2
    assert json.loads(Path("why.json").read_text())["status"] == "rank_deficient"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["few.csv", "why.json"]
    assert capfd.readouterr().out == ""
