"""The demo's report: what happened, why, and how to get it again."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from pcalib import ladder as ladders
from pcalib import report
from pcalib.report import sections
from pcalib.report.page import Page, Section, Text, versions

if TYPE_CHECKING:
    from bench.jobs.demo import Demo, Settings


def write(path: Path, demo: Demo) -> None:
    """Write the report of a demo."""
    report.write(path, page(demo))


def again(settings: Settings) -> str:
    """The command that does the same again, on the same robot file."""
    words = [
        f"pcbench demo --seed {settings.seed} --poses {settings.poses}",
        f"--length-error {settings.sigma_length * 1e3:.9g}mm",
        f"--angle-error {np.degrees(settings.sigma_angle):.9g}deg",
    ]
    if settings.robot_file is not None:
        words.append(f"--robot {shlex.quote(str(settings.robot_file))}")
    if settings.spacing is not None:
        words.append(f"--spacing {settings.spacing * 1e3:.9g}mm")
    words += [f"--tool {','.join(f'{v * 1e3 + 0.0:.9g}' for v in tool)}mm" for tool in settings.tools]
    return " ".join(words)


def page(demo: Demo) -> Page:
    """The report of a demo."""
    ladder, settings, fit = demo.ladder, demo.settings, demo.complete
    robot = demo.truth.robot
    story = Section(
        "What was done",
        [
            Text(
                f"A virtual {robot.kind} got random errors in all {len(robot.mechanism.parameters)} of its dimensions "
                f"(1σ {settings.sigma_length * 1e3:g} mm and {np.degrees(settings.sigma_angle):g}°). MuJoCo took it to "
                f"{settings.poses} D-optimal poses and {settings.check} random ones that were held out; an instrument "
                f"with {settings.noise_pos * 1e3:g} mm and {np.degrees(settings.noise_rot):g}° of noise (1σ per "
                "component) measured the plate there, without a tool. From these data alone the robot was identified, "
                "commands were computed for targets all over the workspace and for tools that were never measured, and "
                "MuJoCo landed the TCP."
            )
        ],
    )
    warned = sections.warnings([(s.label, s.fit) for s in ladder.steps if s.fit is not None])
    source = f"Complete geometry on {fit.accuracy.n_rows} poses; held-out poses took no part in the fit."
    return Page(
        title=f"Calibration of robot “{robot.name}”, demonstration",
        verdict=ladders.sentence(ladder),
        tone="good",
        sections=[
            story,
            sections.ladder(ladder),
            sections.error_maps(ladder),
            sections.data(fit, source),
            sections.parameters(fit, ladder.truth),
            sections.unidentifiable(fit),
            *([warned] if warned else []),
        ],
        provenance={
            **versions(),
            "mujoco": mujoco.__version__,
            "seed": str(settings.seed),
            "robot": f"{robot.name} ({robot.kind})",
            "again": again(settings),
        },
    )
