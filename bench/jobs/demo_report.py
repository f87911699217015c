"""The results of the demo: its files, its report, and what it prints."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from bench import simulate
from bench import truth as truths
from bench.jobs.demo import Demo, Settings
from pcalib import files, modelfile, report, summary, view
from pcalib import ladder as ladders
from pcalib.cli import frame
from pcalib.data import measurement
from pcalib.report import sections
from pcalib.report.page import Page, Section, Text, versions


def write(demo: Demo, folder: Path) -> dict[str, Path]:
    """Write data, truth, models, recording and report into a folder, made where it is not there; paths by name.

    Raises:
        InputError: the folder cannot be written.
    """
    name, seed = demo.truth.robot.name, demo.settings.seed
    with files.atomic_folder(folder) as fresh:
        out = {"data": fresh / "data.csv"}
        measurement.save(out["data"], demo.data)
        out["truth"] = simulate.truth_path(out["data"])
        files.write_text(out["truth"], truths.dumps(demo.truth, {"job": "demo", "seed": seed}))
        for step in demo.ladder.steps:
            if step.fit is not None:
                out[step.name] = fresh / f"{step.name}.toml"
                modelfile.save(out[step.name], step.model, summary.statistics(step.fit))
        out["recording"], out["report"] = fresh / "demo.rrd", fresh / "report.html"
        view.write(out["recording"], demo.ladder, identity=f"demo of {name}, seed {seed}")
        report.write(out["report"], page(demo))
    return {key: folder / path.name for key, path in out.items()}


def show(demo: Demo, made: Mapping[str, Path], seconds: float) -> None:
    """Print the outcome: one sentence, the ladder, what was written."""
    frame.say(ladders.sentence(demo.ladder))
    print()
    frame.show_table(*ladders.table(demo.ladder))
    folder, n = made["report"].parent, len(demo.ladder.maps[0].targets)
    frame.say(
        f"{len(demo.data)} measured poses, {demo.settings.check} of them held out; {n} targets per tool, landed by "
        f"MuJoCo; {seconds:.1f} s. Files in {folder}:"
    )
    frame.say(f"- {made['report'].name}: the report, for any browser")
    frame.say(f"- {made['recording'].name}: the robot and its error field; open it with: {_pcalib()} view {folder}")
    frame.say(f"- {made['data'].name}, {made['truth'].name}, {made['complete'].name} …: data, truth and models")


def _pcalib() -> str:
    """How `pcalib` can be called from here."""
    if shutil.which("pcalib"):
        return "pcalib"
    beside = Path(sys.executable).with_name("pcalib")
    return os.path.relpath(beside) if beside.exists() else f"{Path(sys.executable).name} -m pcalib"


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
