"""Good files of what instruments write: sensors that read no pose, readings without commands, σ of single axes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bench import plan as plans
from bench import simulate
from bench import truth as truths
from pcalib import rotation
from pcalib.data import measurement, table
from pcalib.mechanics import kinematics
from pcalib.robot import Robot

SENSED = """\
robot = "robot.toml"
[geometry]
sigma_length_mm = 0.1
seed = 2
[instrument]
kind = "none"
[sensors.ballbar]
sigma_um = 2
stations_mm = [300, 0, -1050, -200, 250, -1050]
[sensors.inclinometer]
sigma_urad = 20
zero_mrad = [3, -2]
[sensors.dial_gauge]
place_mm = [0, 0, -1100]
"""
_STILL, _RATE = 0.5, 20.0
"""[s] how long a robot stands at each pose, and [Hz] of a recording."""


def make(folder: Path, delta: Robot) -> None:
    """Write files of all instruments and recordings into a folder that holds robot.toml."""
    truth = truths.parse(SENSED.replace("robot.toml", str(folder / "robot.toml")))
    tools = [np.zeros(3), np.array([0.0, 0.0, -0.15])]
    sensed = simulate.run(truth, plans.make(truth.robot, "random", 45, check=6, tools=tools, seed=4), 4).measurements
    measurement.save(folder / "sensed.csv", sensed)

    q = np.unique(sensed.q, axis=0)[:8]
    pose = kinematics.forward(delta.mechanism, delta.mechanism.nominal, q).pose
    x, R, names = 1e3 * pose.x, pose.R, [f"P{i + 1}" for i in range(len(q))]
    commands = {f"q{i + 1}_deg": np.degrees(q[:, i]) for i in range(3)}
    table.write(folder / "commands.csv", {"name": names, "time_s": 2.0 * np.arange(len(q)), **commands}, {})
    places = {f"{axis}_mm": x[:, i] for i, axis in enumerate("xyz")}
    sigma = {"sigma_x_mm": "0.02", "sigma_y_mm": "0.02", "sigma_z_mm": "0.2"}
    depth = {"sigma_z_mm": np.linspace(0.1, 0.3, len(q))}
    table.write(folder / "axes.csv", commands | places | depth, sigma)
    apart = np.linalg.norm(x - x[0], axis=1)
    gauge = {"pose_id": names, "distance_mm": [None, *apart[1:]], "from": ["", *["P1"] * (len(q) - 1)]}
    table.write(
        folder / "gauge.csv", commands | places | gauge,
        {"sigma_pos_mm": "0.02", "sigma_distance_um": "2"},
    )  # fmt: skip
    points = [_line([name, *point], ", ") for name, point in zip(names, x, strict=True)]
    (folder / "points.txt").write_text("Units: mm\n" + "".join(points))
    (folder / "matrices.txt").write_text(
        "".join(_line([*np.hstack([r, p[:, None]]).ravel()], " ") for r, p in zip(R, x, strict=True))
    )
    stays = np.repeat(np.arange(len(q)), int(_STILL * _RATE))
    time = stays * 2.0 + np.tile(np.arange(int(_STILL * _RATE)) / _RATE, len(q))
    w, *v = rotation.to_quaternion(R[stays]).T
    (folder / "motive.csv").write_text(
        "Format Version,1.23,Rotation Type,Quaternion,Length Units,Millimeters\n\n,Type" + ",Rigid Body" * 7
        + "\n,Name" + ",plate" * 7 + "\n,," + "Rotation," * 4 + "Position,Position,Position\n"
        + "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z\n"
        + "".join(_line([i, *row], ",") for i, row in enumerate(np.column_stack([time, *v, w, x[stays]]).tolist()))
    )  # fmt: skip
    turned = rotation.log(R[stays])
    (folder / "vicon.csv").write_text(
        "Objects\n20\n,,plate\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,rad,rad,rad,mm,mm,mm\n"
        + "".join(_line([i + 1, 0, *row], ",") for i, row in enumerate(np.hstack([turned, x[stays]]).tolist()))
    )
    bed = [(50 * i, 30 * (j - 1), 0.1 * i - 0.05 * j) for i in (-1, 0, 1) for j in range(3)]
    (folder / "heights.csv").write_text("".join(_line(point, ",") for point in bed))
    (folder / "probed.txt").write_text("".join(f"probe at {a:.3f},{b:.3f} is z={c:.6f}\n" for a, b, c in bed))


def _line(cells: Iterable[str | float], separator: str) -> str:
    return separator.join(c if isinstance(c, str) else f"{c:.9g}" for c in cells) + "\n"
