"""Pictures and descriptions of all faults for docs/bench.md: where in the workspace each one moves the TCP, and how.

    python -m bench.jobs.fault_fields          # rewrites docs/faults/*.png and the chapter in docs/bench.md
"""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench import faults
from bench.commands import Commands
from bench.kinds import MODELS
from bench.machine import Machine
from bench.reach import reach
from pcalib import files, units
from pcalib import robot as robots
from pcalib.robot import Robot
from pcalib.settings import Setting

DOCS = MODELS.parent / "docs"
BEGIN, END = "<!-- faults: begin -->", "<!-- faults: end -->"
TOOL = np.array([0.05, 0.0, -0.10])
CONDITIONS = "payload 1 kg, tool (50, 0, −100) mm, all last motions upwards, 10 K above 20 °C, after one hour"
FELT_WITH = {"hose": "drive_compliance", "gravity_tilt": "drive_compliance"}
"""Faults that a rigid robot does not feel, and what they are shown with."""
HEIGHT, STEP = -0.8, 0.08


@dataclass(frozen=True)
class Field:
    """Displacements of the TCP over one plane of the workspace."""

    x: np.ndarray
    """(N, 3) [m] where the plate is sent."""
    d: np.ndarray
    """(N, 3) [m] displacement; NaN out of reach."""


def commands(robot: Robot, q: np.ndarray) -> Commands:
    """The conditions of the pictures."""
    warm = {f"temp_{part}": 30.0 for part in ("arms", "rods", "base")}
    way = {f"dir{i + 1}": 1.0 for i in range(q.shape[1])}
    return Commands.of(q, TOOL, 1.0, time=3600.0, **warm, **way)


def fields(robot: Robot, name: str) -> list[Field]:
    """What a fault of usual size does in the planes z = −0.8 m and y = 0."""
    partner = [faults.typical(robot, FELT_WITH[name])] if name in FELT_WITH else []
    before, after = Machine(robot, None, partner), Machine(robot, None, [*partner, faults.typical(robot, name)])
    plain = Machine(robot)
    space, out = robot.workspace, []
    across = np.arange(-space.radius, space.radius + 1e-9, STEP)
    upwards = np.linspace(space.z_min, space.z_max, 6)
    for grid in ([(x, y, HEIGHT) for x in across for y in across], [(x, 0.0, z) for x in across for z in upwards]):
        x = np.array([p for p in grid if space.contains(np.array(p))])
        q, ok = reach(plain, x)
        x, there = x[ok], commands(robot, q[ok])
        one, two = before.run(there), after.run(there)
        seen = [_seen(machine, landing.tcp, landing.R, there) for machine, landing in ((before, one), (after, two))]
        out.append(Field(x, seen[1] - seen[0]))
    return out


def _seen(machine: Machine, tcp: np.ndarray, R: np.ndarray, there: Commands) -> np.ndarray:
    for fault in machine.faults:
        tcp, R = fault.seen(tcp, R, there)
    return tcp


def draw(robot: Robot, name: str, path: Path) -> None:
    """One picture: seen from above at z = −0.8 m, and from the side at y = 0."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    planes = fields(robot, name)
    size = [np.linalg.norm(f.d, axis=1) * 1e6 for f in planes]
    top = max(np.nanmax(s) for s in size)
    figure, axes = plt.subplots(1, 2, figsize=(7.6, 3.3), width_ratios=[1.0, 1.35], layout="constrained")
    dots: Any = None
    for axis, field, sizes, (i, j), title in zip(
        axes, planes, size, ((0, 1), (0, 2)), ("from above, z = −800 mm", "from the side, y = 0"), strict=True
    ):
        where = field.x * 1e3
        dots = axis.scatter(where[:, i], where[:, j], c=sizes, s=38, cmap="viridis", vmin=0, vmax=top, linewidths=0)
        axis.quiver(
            where[:, i], where[:, j], field.d[:, i] * 1e6, field.d[:, j] * 1e6, angles="xy", scale_units="xy",
            scale=top / 75, width=0.005, color="#d1495b",
        )  # fmt: skip
        axis.set(xlabel=f"{'xyz'[i]} [mm]", ylabel=f"{'xyz'[j]} [mm]", xlim=(-480, 480))
        axis.set_title(title, fontsize=9)
        axis.tick_params(labelsize=8)
    axes[0].set_aspect("equal")
    axes[0].set_ylim(-480, 480)
    axes[1].set_ylim(-1000, -600)
    bar = figure.colorbar(dots, ax=axes[1], label="displacement of the TCP [µm]")
    bar.ax.tick_params(labelsize=8)
    with files.atomic(path) as temporary:
        figure.savefig(temporary, dpi=95, metadata={"Software": None})
    plt.close(figure)


def describe(robot: Robot, name: str) -> str:
    """A fault's section of the documentation, from its own docstrings and settings."""
    fault = faults.get(name)
    title = (inspect.getdoc(inspect.getmodule(fault)) or "").splitlines()[0]
    physics = re.sub(r"[ \n]+", " ", (inspect.getdoc(fault) or "").replace("\n\n", "¶")).replace("¶", "\n\n")
    rows = []
    for setting in fault.settings(robot):
        each = {"actuator": " (per drive)", "rod": " (per rod)"}
        of = each.get(setting.per, " (x, y, z)" if setting.count == 3 else "")
        usual = _shown(setting, setting.typical)
        rows.append(f"| `{_key(setting)}` | {setting.about}{of} | {usual} | {_default(setting)} |")
    table = "\n".join(["| setting | what | usual | default |", "|---|---|---|---|", *rows])
    needs = fault.NEEDS if isinstance(fault.NEEDS, tuple) else tuple(f"dir{i + 1}" for i in range(3))
    needed = f"\n\nNeeds the columns {', '.join(f'`{c}`' for c in needs)}." if needs else ""
    beside = f" (with {FELT_WITH[name]})" if name in FELT_WITH else ""
    return (
        f"### {name}\n{title}\n\n{physics}\n\n{table}\n\nIn the model: {fault.MJCF}.{needed}\n\n"
        f"![TCP displacement by {name}{beside}](faults/{name}.png)\n"
    )


def chapter(robot: Robot) -> str:
    """All sections, between the marks of docs/bench.md."""
    sections = "\n".join(describe(robot, name) for name in faults.names())
    return f"{BEGIN}\nPictures: a fault of usual size on the default robot; {CONDITIONS}.\n\n{sections}{END}"


def _unit(setting: Setting) -> units.Unit | None:
    shown = {
        "rotational_compliance": "urad_Nm", "compliance": "um_N", "angle": "urad", "length": "um", "expansion": "ppm_K",
        "velocity": "um_h", "angular_velocity": "urad_h", "ratio": "ppm", "stiffness": "N_m", "count": "per_rev",
        "angle_per_kelvin": "urad_K", "time": "s",
    }  # fmt: skip
    return units.UNITS.get(shown.get(setting.dimension, ""))


def _key(setting: Setting) -> str:
    unit = _unit(setting)
    return setting.name if unit is None else f"{setting.name}_{unit.suffix}"


def _shown(setting: Setting, value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return f"`{value}`"
    unit = _unit(setting)
    numbers = np.atleast_1d(np.asarray(value, float)) / (1.0 if unit is None else unit.factor)
    return ", ".join(f"{v:.4g}" for v in numbers)


def _default(setting: Setting) -> str:
    return "required" if setting.default is None else _shown(setting, setting.default)


def main() -> None:
    """Draw the pictures of all faults and rewrite their chapter in docs/bench.md."""
    robot = robots.load(MODELS / "delta.toml")
    (DOCS / "faults").mkdir(exist_ok=True)
    for name in faults.names():
        draw(robot, name, DOCS / "faults" / f"{name}.png")
    page = DOCS / "bench.md"
    text = page.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    files.write_text(page, before + chapter(robot) + rest.split(END)[1])


if __name__ == "__main__":
    main()
