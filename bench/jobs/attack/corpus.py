"""A folder with a good file of every role, and the commands that read a file of that role."""

from __future__ import annotations

import contextlib
import io
import textwrap
from pathlib import Path

import numpy as np

from bench.jobs.attack import instruments
from bench.kinds import MODELS
from pcalib import cli as pcalib
from pcalib import modelfile, planning, rotation
from pcalib import robot as robots
from pcalib.data import measurement, table
from pcalib.mechanics import kinematics
from pcalib.model import Model

DELTA = MODELS / "delta.toml"

COMMANDS = {
    "data": """
        pcalib inspect {} --robot robot.toml
        pcalib fit {} --robot robot.toml -o new.toml --json new.json
        pcalib compare {} --model m.toml --report new.html --rrd new.rrd --json new.json
        pcalib diagnose {} --model m.toml --report new.html --json new.json
        pcalib explain drive_compliance {} --model m.toml --plot new.svg --json new.json
        pcalib add drive_compliance {} --model m.toml -o new.toml --json new.json
        pcalib drop drive_compliance {} --model soft.toml -o new.toml --json new.json
        pcalib next {} --model m.toml --between drive_compliance,backlash -n 2 -o new.csv --json new.json
        pcalib join data.csv {} -o new.csv
    """,
    "robot": """
        pcalib inspect data.csv --robot {} --json new.json
        pcalib fit data.csv --robot {} -o new.toml --json new.json
        pcalib plan --robot {} -n 8 -o new.csv
        pcalib effect list --robot {}
        pcalib effect check mine.py:Mine --robot {}
        pcbench demo --robot {} -o new
        pcbench blind --robot {} -n 1 -o new
    """,
    "model": """
        pcalib compare data.csv --model {} --report new.html --rrd new.rrd --json new.json
        pcalib diagnose data.csv --model {} --report new.html --json new.json
        pcalib explain drive_compliance data.csv --model {} --plot new.svg
        pcalib add drive_compliance data.csv --model {} -o new.toml
        pcalib drop drive_compliance data.csv --model {} -o new.toml
        pcalib next data.csv --model {} --between drive_compliance,backlash -n 2 -o new.csv
        pcalib log {} --json new.json
        pcalib compensate targets.csv --model {} -o new.csv --json new.json
        pcalib view {} --save new.rrd
        pcalib firmware {} --json new.json
        pcbench verify {} truth.toml --json new.json
    """,
    "targets": """
        pcalib compensate {} --model m.toml -o new.csv --json new.json
        pcbench verify m.toml truth.toml --targets {} --json new.json
    """,
    "truth": """
        pcbench simulate {} -n 4 -o new.csv --json new.json
        pcbench verify m.toml {} --json new.json
    """,
    "plan": "pcbench simulate truth.toml --plan {} -o new.csv --json new.json",
    "spec": """
        pcbench campaign {} --workers 1 -o new --json new.json
        pcbench regress {} --baseline base.json --json new.json
    """,
    "baseline": "pcbench regress spec.toml --baseline {} --json new.json",
    "steps": "pcalib import carriage-steps {} -o new.csv --robot-output new.toml --json new.json",
    "capture": "pcalib import motion-capture {} -o new.csv --robot-output new.toml --json new.json",
    "sensed": """
        pcalib inspect {} --robot robot.toml --json new.json
        pcalib fit {} --robot robot.toml -o new.toml --json new.json
        pcalib compare {} --model setup.toml --json new.json
        pcalib diagnose {} --model setup.toml --json new.json
        pcalib join sensed.csv {} -o new.csv
    """,
    "gauge": """
        pcalib inspect {} --robot robot.toml --json new.json
        pcalib compare {} --model m.toml --json new.json
    """,
    "axes": """
        pcalib inspect {} --robot robot.toml --json new.json
        pcalib compare {} --model m.toml --json new.json
    """,
    "setup": """
        pcalib compare sensed.csv --model {} --json new.json
        pcalib diagnose sensed.csv --model {} --json new.json
        pcalib compensate targets.csv --model {} -o new.csv
        pcalib log {} --json new.json
    """,
    "points": "pcalib import point-list {} --robot robot.toml --commands commands.csv -o new.csv --json new.json",
    "matrices": "pcalib import matrices {} --robot robot.toml --commands commands.csv --pair order -o new.csv",
    "motive": "pcalib import motive {} --robot robot.toml --commands commands.csv --pair time -o new.csv",
    "vicon": "pcalib import vicon {} --robot robot.toml --commands commands.csv -o new.csv",
    "commands": """
        pcalib import point-list points.txt --robot robot.toml --commands {} -o new.csv --json new.json
        pcalib import motive motive.csv --robot robot.toml --commands {} --pair time -o new.csv
    """,
    "heights": "pcalib import bed-heights {} -o new.csv --robot-output new.toml --json new.json",
    "probed": "pcalib import bed-heights {} -o new.csv --robot-output new.toml",
    "effect": """
        pcalib fit data.csv --robot robot.toml --effect {}:Mine -o new.toml
        pcalib diagnose data.csv --model m.toml --effect {}:Mine --json new.json
        pcalib explain {}:Mine data.csv --model m.toml --plot new.svg
        pcalib add {}:Mine data.csv --model m.toml -o new.toml
        pcalib next data.csv --model m.toml --between {}:Mine,backlash -o new.csv
        pcalib effect check {}:Mine --robot robot.toml
    """,
    "diagnosis": "pcbench score {} --json new.json",
}
"""Commands by the role of the file that {} stands for."""

SPEC = """\
    name = "small"
    robot = "delta"
    robots = 2
    seed = 11
    [plan]
    poses = 14
    [verify]
    targets = 8
    tools_mm = [0, 300]
"""
TRUTH = """\
    robot = "robot.toml"
    [geometry]
    sigma_length_mm = 0.1
    seed = 1
    [instrument]
    sigma_pos_mm = 0.02
    [faults.drive_compliance]
    compliance_urad_Nm = 10
"""
EFFECT = """\
    import numpy as np
    from pcalib.effects import Contribution, EffectParameter
    class Mine:
        name = "mine"
        parameters = (EffectParameter("size", "urad", 1e-4),)
        needs = ()
        def contribution(self, at, theta):
            return Contribution(actuator=theta[0] * np.sin(3 * at.q))
"""


def make(folder: Path) -> None:
    """Write a good file of every role into a folder."""
    delta = robots.load(DELTA)
    rng = np.random.default_rng(5)
    k = delta.mechanism.nominal + 1e-4 * rng.standard_normal(60)
    q = np.repeat(planning.reachable(delta, 30, rng).q, 2, axis=0)
    pose = kinematics.forward(delta.mechanism, k, q).pose
    n = len(q)
    data = measurement.Measurements.create(
        delta, q, pose.x + 2e-5 * rng.standard_normal((n, 3)),
        rotation.exp(1e-4 * rng.standard_normal((n, 3))) @ pose.R,
        payload=np.repeat(rng.integers(0, 3, n // 2), 2), pose_id=np.arange(n) // 2, check=np.arange(n) >= 50,
        columns={f"dir{i + 1}": np.repeat(rng.choice([-1.0, 1.0], n // 2), 2) for i in range(3)},
        sigma_pos=2e-5, sigma_rot=1e-4,
    )  # fmt: skip
    measurement.save(folder / "data.csv", data)
    (folder / "robot.toml").write_text(DELTA.read_text())
    for name, text in (("spec.toml", SPEC), ("truth.toml", TRUTH), ("mine.py", EFFECT)):
        (folder / name).write_text(textwrap.dedent(text))
    (folder / "targets.csv").write_text("x_mm,y_mm,z_mm\n0,0,-800\n50,20,-850\n")
    table.write(folder / "plan.csv", {f"q{i + 1}_deg": np.degrees(q[:4, i]) for i in range(3)}, {})
    (folder / "base.json").write_text("{}")
    (folder / "steps.csv").write_text("35249,35451,35413\n35301,35400,35388\n35190,35512,35420\n" * 4)
    (folder / "blind" / "sealed").mkdir(parents=True)
    instruments.make(folder, delta)
    linear = robots.load(MODELS / "linear_delta.toml")
    modelfile.save(folder / "printer.toml", Model.nominal(linear))
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        pcalib.main("fit data.csv --robot robot.toml -o m.toml".split())
        pcalib.main("fit sensed.csv --robot robot.toml -o setup.toml".split())
        pcalib.main("add drive_compliance data.csv --model m.toml -o soft.toml".split())
