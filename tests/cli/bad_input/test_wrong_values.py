"""Robots, models, targets, truths, plans and campaigns: a good file with one thing changed."""

from __future__ import annotations

import re

import pytest

GOOD = {
    "robot": "robot.toml", "model": "m.toml", "targets": "targets.csv", "truth": "truth.toml", "plan": "plan.csv",
    "spec": "spec.toml",
}  # fmt: skip

CHANGED: dict[str, dict[str, tuple[str, str, str]]] = {
    "robot": {
        "no unit": ("arm_length_mm", "arm_length", r":7: \[geometry\] key 'arm_length' has no unit"),
        "unit of another dimension": ("arm_length_mm", "arm_length_deg", r":7: .*'deg' is not a unit of length"),
        "key unknown": ("rod_length_mm", "rods_mm", r":8: .*unknown key 'rods_mm'"),
        "key missing": (r"rod_length_mm.*\n", "", r"'rod_length' is missing"),
        "twice in other units": ("arm_length_mm", "arm_length_m = 0.3\narm_length_mm", r"'arm_length' is given twice"),
        "text": (r"arm_length_mm = .*", 'arm_length_mm = "long"', r":7: .*must be a number, not 'long'"),
        "NaN": (r"arm_length_mm = .*", "arm_length_mm = nan", r":7: .*must be a number, not nan"),
        "zero": (r"arm_length_mm = .*", "arm_length_mm = 0", r":7: .*must be from 0.1 to 100000"),
        "negative": (r"arm_length_mm = .*", "arm_length_mm = -350", r":7: .*must be from 0.1 to 100000"),
        "kind": ('kind = "delta"', 'kind = "detla"', r":\d+: unknown robot kind 'detla' \(did you mean 'delta'\?\)"),
        "section": (r"\[workspace\]", "[works]", r":\d+: unknown key 'works'.*accepted"),
        "range": ("min_deg = -60.0", "min_deg = 60.0", r":14: \[joints\] min must be below max"),
        "degrees as radians": ("axis_azimuth_deg", "axis_azimuth_rad", r":11: .*from -6.28.*\n.*azimuth_deg"),
        "joints in degrees as radians": (r"min_deg = .*\nmax_deg", "min_rad = -60\nmax_rad", r":14: .*-6.28.*\n.*_deg"),
        "too few azimuths": (r"axis_azimuth_deg = .*", "axis_azimuth_deg = [0, 120]", r":11: .*list of 3 numbers"),
        "negative mass": ("arm_kg = 1.0", "arm_kg = -1.0", r":\d+: \[mass\] 'arm_kg' must be from 0 to"),
    },
    "model": {
        "schema": ("pcalib.model/1", "pcalib.model/9", "not a model file"),
        "level": ('level = "complete"', 'level = "competle"', "level 'competle' is not one of"),
        "NaN": (r"value_mm = .*", "value_mm = nan", r":\d+: .*must be a number, not nan"),
        "text": (r"value_mm = .*", 'value_mm = "x"', r":\d+: .*must be a number, not \'x\'"),
        "unit": (r"value_mm = ", "value_deg = ", "'deg' is not a unit of length"),
        "parameter unknown": (r"\[parameters.l11\]", "[parameters.l99]", "parameter 'l99' is not one of"),
        "negative σ": (r"sigma_mm = .*", "sigma_mm = -1", "'sigma_mm' must be from 0"),
        "an effect unknown": (r"effects = \[\]", 'effects = [{spec = "gremlins"}]', "unknown effect 'gremlins'"),
        "history of figures that are none": (
            r"(?s)(\[\[history\]\].*?)rms_pos_um = \S+", r'\g<1>rms_pos_um = "x"', "1: rms_pos_um must be a number",
        ),
        "history of effects that are none": (
            r"(?s)(\[\[history\]\].*?)effects = \[\]", r"\g<1>effects = [3]", "entry 1: effects is no list of tables",
        ),
        "history of a check that is none": (r"\[history.check\]", "[[history.check]]", "1: check is missing, or is"),
        "another robot": ('kind = "delta"', 'kind = "hexapod"', r"\[geometry\]"),
        "cut off": (r"(?s)\[parameters\.l11\].*", "[parameters.l11", "not valid TOML"),
    },
    "targets": {
        "no unit": ("x_mm", "x", r":1: column 'x' has no unit"),
        "unit of another dimension": ("x_mm", "x_deg", r":1: .*'deg' is not a unit of length"),
        "unit wrong": ("x_mm,y_mm,z_mm", "x_m,y_m,z_m", r":2: .*\n  the values look like mm"),
        "NaN": ("0,0,-800", "0,nan,-800", r":2: column 'y_mm': 'nan' is not a finite number"),
        "blank": ("0,0,-800", "0,,-800", r":2: column 'y_mm': the field is blank"),
        "upside down": (r"-800\n(.*)-850", r"800\n\g<1>850", r":2: .*far off the workspace.*\n.*sign of z"),
        "twice": ("y_mm", "x_mm", r":1: column 'x_mm' is given twice"),
        "short row": ("0,0,-800", "0,-800", r":2: 2 fields where the header has 3"),
        "no z": (r",z_mm\n0,0,-800\n50,20,-850", "\n0,0\n", r":1: column 'z' is missing"),
        "header only": (r"(?s)\n.*", "\n", "there is a header but no row"),
        "rotation": (r"(?s).*", "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n0,0,-800,1,0,0\n", "commands x y z only"),
        "negative payload": (r"(?s).*", "x_mm,y_mm,z_mm,payload_kg\n0,0,-800,-1\n", r":2: .*a payload cannot be neg"),
        "half a tool": (r"(?s).*", "x_mm,y_mm,z_mm,tool_x_mm\n0,0,-800,1\n", "column 'tool_y' is missing"),
    },
    "truth": {
        "no robot": (r"robot = .*", "", "'robot' is missing"),
        "robot absent": ("robot.toml", "robbot.toml", r":1: robot file 'robbot.toml' does not exist"),
        "no unit": ("sigma_length_mm", "sigma_length", r":3: .*'sigma_length' has no unit"),
        "unit of another dimension": ("sigma_length_mm", "sigma_length_deg", r":3: .*'deg' is not a unit of length"),
        "key unknown": ("seed", "sede", r":4: .*unknown key 'sede'"),
        "section unknown": (r"\[instrument\]", "[instrumental]", "unknown key 'instrumental'"),
        "fault unknown": ("drive_compliance", "drive_complience", r"did you mean 'drive_compliance'"),
        "NaN": ("Nm = 10", "Nm = nan", r":8: .*must be a number"),
        "negative": ("Nm = 10", "Nm = -10", r":8: .*must be from 0"),
        "wrong count": ("Nm = 10", "Nm = [10, 20]", r":8: .*a list of 3 numbers"),
        "negative seed": ("seed = 1", "seed = -1", r":4: .*'seed' must be at least 0"),
        "parameter unknown": ("seed = 1", "errors = {l99_mm = 1}", "unknown parameter 'l99'"),
    },
    "plan": {
        "no unit": ("q1_deg", "q1", r":\d: column 'q1' has no unit"),
        "NaN": (r"\n-?\d[^,]*,", "\nnan,", r":\d: column 'q1_deg': 'nan' is not a finite number"),
        "an actuator missing": ("q3_deg", "other", "column 'q3' is missing"),
        "twice": ("q2_deg", "q1_deg", "column 'q1_deg' is given twice"),
        "radians": ("q1_deg,q2_deg,q3_deg", "q1_rad,q2_rad,q3_rad", r":\d: column 'q1_rad': .*outside .*\n.*q1_deg"),
    },
    "spec": {
        "key unknown": ("seed", "sede", r":4: unknown key 'sede'"),
        "robot unknown": ('"delta"', '"detla"', r":2: robot: unknown robot 'detla'"),
        "no unit": (r"\[plan\]", "[geometry]\nsigma_length = 1\n[plan]", "'sigma_length' has no unit"),
        "text": ("poses = 14", 'poses = "many"', r":\d: .*must be a number, not 'many'"),
        "negative": ("robots = 2", "robots = -2", r":3: .*'robots' must be from 1"),
        "NaN": (r"\[plan\]", "[instrument]\nsigma_pos_mm = nan\n[plan]", "must be a number, not nan"),
        "tools": (r"\[0, 300\]", '["long"]', "must be a list of lengths"),
        "method": (r"\[plan\]", '[[method]]\nname = "magic"\n[plan]', "magic"),
    },
}  # fmt: skip


@pytest.mark.parametrize(("role", "case"), [(role, case) for role, cases in CHANGED.items() for case in cases])
def test_one_thing_wrong(role, case, cell, one_refused):
    old, new, said = CHANGED[role][case]
    good = cell / GOOD[role]
    text, count = re.subn(old, new, good.read_text(), count=1)
    assert count == 1
    bad = f"bad{good.suffix}"
    (cell / bad).write_text(text)
    one_refused(role, bad, said, "robbot.toml" if case == "robot absent" else bad)
