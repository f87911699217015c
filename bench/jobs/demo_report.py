"""The demo's report: what happened, why, and how to get it again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from pcalib import ladder as ladders
from pcalib import report
from pcalib.report import sections
from pcalib.report.page import Page, Section, Text, versions

if TYPE_CHECKING:
    from bench.jobs.demo import Demo


def write(path: Path, demo: Demo) -> None:
    """Write the report of a demo."""
    report.write(path, page(demo))


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
    source = f"Complete geometry on {fit.fit.n_rows} poses; held-out poses took no part in the fit."
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
            "robot": robot.name,
            "again": f"pcbench demo --seed {settings.seed}",
        },
    )
