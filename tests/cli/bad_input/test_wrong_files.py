"""Files that are no files, or hold something else."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

ROLES = ["data", "robot", "model", "targets", "truth", "plan", "spec", "steps", "capture"]
NO_FILES = {
    "absent": (None, r"no such file|unknown plan|does not exist|holds no"),
    "empty": (b"", r"the file is empty|no recording"),
    "blank": (b"\n  \n", r"the file is empty|no recording"),
    "latin-1": ("x_mm,y_mm\n# Prüfling\n".encode("latin-1"), r":2: (?:not UTF-8 text|1 fields where)|no recording"),
    "binary": (bytes(range(256)) * 9, r": not UTF-8 text|no recording"),
    "something.parquet": (b"no Parquet at all", r"not a readable Parquet file|not valid TOML|not three|no recording"),
}


@pytest.mark.parametrize("case", NO_FILES)
@pytest.mark.parametrize("role", ROLES)
def test_no_usable_file(role, case, cell, each_refused):
    content, said = NO_FILES[case]
    name = case if "." in case else f"{case}.x"
    if content is not None:
        (cell / name).write_bytes(content)
    each_refused(role, name, said)


@pytest.mark.parametrize("role", ROLES)
def test_a_directory(role, cell, each_refused):
    (cell / "folder").mkdir(exist_ok=True)
    each_refused(role, "folder", r"is a directory|no recording|unknown plan")


@pytest.mark.parametrize("role", ["robot", "model", "truth", "spec"])
@pytest.mark.parametrize("text", ["[geometry\nx = 1\n", "a = {", "a = " + "[" * 5000, 'name = "x"\n\na = 1\na = 2\n'])
def test_broken_toml(role, text, cell, each_refused):
    (cell / "broken.toml").write_text(text)
    each_refused(role, "broken.toml", r"^error: broken\.toml(:\d+)?: not valid TOML")


@pytest.mark.parametrize(
    ("role", "other", "said"),
    [
        ("data", "m.toml", r"has \d+ fields|fields where|column"),
        ("data", "targets.csv", "column 'q1' is missing: it holds the commanded"),
        ("data", "plan.csv", "column 'x' is missing: it holds the measured position"),
        ("robot", "data.csv", "data.csv:.*: not valid TOML"),
        ("robot", "m.toml", r"m\.toml:1: unknown key 'schema'"),
        ("model", "robot.toml", "not a model file"),
        ("model", "data.csv", "not valid TOML|no recording"),
        ("truth", "robot.toml", "unknown key 'name'"),
        ("spec", "robot.toml", "unknown key 'kind'"),
        ("plan", "targets.csv", "column 'q1' is missing: a plan holds the commanded"),
        ("steps", "data.csv", "is not three step counts"),
        ("capture", "data.csv", "column 'leg_length_1' is missing"),
    ],
)
def test_a_file_of_another_kind(role, other, said, each_refused):
    each_refused(role, other, said)



@pytest.mark.parametrize(
    ("role", "text", "said"),
    [
        ("steps", "1,2\n3,4\n", r":1: '1,2' is not three step counts"),
        ("steps", "35249,nan,35413\n" * 9, r":1: .*is not three step counts"),
        ("steps", "35249,35451,35413\n" * 2, "2 contacts are too few"),
        ("steps", "35249,-35451,35413\n" * 9, r":1: negative steps put a carriage beyond its endstop"),
        ("steps", "3e9,3e9,3e9\n" * 9, r":1: these steps put a carriage .* below the bed"),
        ("capture", "leg_length_1,leg_length_2\n1,2\n", r":1: column 'leg_length_3' is missing"),
        ("baseline", "[1]", "not a JSON object"),
        ("baseline", "{}", "is no baseline of pcbench regress"),
        ("baseline", "{", r":1: not valid JSON"),
    ],
)
def test_other_files(role, text, said, cell, each_refused):
    (cell / "bad.x").write_text(text)
    each_refused(role, "bad.x", said)


@pytest.mark.parametrize(
    "text",
    ["{", "[" * 9999, "[]", "{}", '{"schema": "pcalib.diagnosis/1", "verdict": "maybe"}'],
    ids=["cut", "deep", "list", "empty", "half"],
)
def test_diagnoses_that_cannot_be_scored(text, cell, refused):
    blind = cell / "blind"
    sealed = (
        '{"schema": "pcbench.sealed/1", "data": "001.csv", "design": "rich", "effects": [], "faults": [], '
        '"s": 0.0, "s_outside": 0.0}'
    )
    (blind / "sealed" / "001.json").write_text(sealed)
    (blind / "001.diagnosis.json").write_text(text)
    refused("pcbench score blind --json new.json", "001.diagnosis.json")
    (blind / "001.diagnosis.json").unlink()
    refused("pcbench score blind --json new.json", "holds no diagnosis")
    (blind / "sealed" / "001.json").write_text("{")
    refused("pcbench score blind --json new.json", r"001\.json:1: not valid JSON")
    (blind / "sealed" / "001.json").unlink()


def test_data_and_model_of_another_robot(refused, each_refused):
    said = r"'deg' is not a unit of length|far off the workspace|the truth of 'delta'"
    each_refused("model", "printer.toml", said, "", but="log|view|firmware")
    refused("pcalib firmware m.toml --json new.json", "printer firmware knows linear Deltas")
    for name in ("hexapod", "h4", "delta_small", "linear_delta"):
        for command in ("fit data.csv -o new.toml", "inspect data.csv"):
            refused(
                f"pcalib {command} --robot {ROOT}/models/{name}.toml",
                r"data.csv:\d+: .*(is not a unit of|is missing|far off the workspace|joint range)",
            )


@pytest.mark.parametrize(
    ("old", "new"),
    [("z_min_mm = -925.0\nz_max_mm = -675.0", "z_min_mm = -2925\nz_max_mm = -2675"), ("min_deg = -60", "min_deg = 44")],
    ids=["workspace", "joints"],
)
def test_a_robot_that_cannot_reach_its_workspace(old, new, cell, each_refused):
    text = (cell / "robot.toml").read_text()
    assert old in text
    (cell / "short.toml").write_text(text.replace(old, new))
    each_refused("robot", "short.toml", r"workspace.*\n.*\[joints\]", "", but="inspect|fit|effect list|blind")


def test_a_model_that_is_no_robot_any_more(cell, each_refused):
    """A digit too many in a model file: read well, but the loops cannot close."""
    text, count = re.subn(r"(parameters\.l11\][^\[]*?value_mm = )\S+", r"\g<1>3000.0", (cell / "m.toml").read_text())
    assert count == 1
    (cell / "far.toml").write_text(text)
    said = "cannot close its loops|cannot stand|no target was reached"
    each_refused("model", "far.toml", said, "", but="log|firmware|compensate")
