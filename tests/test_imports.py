"""Who may import whom: the core never sees MuJoCo, and the virtual robot never sees the core's formulas."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = {
    "errors", "units", "files", "robot", "rotation",
    "data.measurement", "data.columns", "data.table", "data.plausibility",
}  # fmt: skip
"""What the virtual robot may take from pcalib: descriptions, files with what is checked on reading, and rotations."""
NOT_OF_A_ROBOT = {"actuation", "levels", "start", "plate_points", "plate_columns", "body", "hinges", "actuator"}
"""Members of `robot.mechanism` that hold kinematics, not names and nominal values."""


def imported(file: Path) -> set[str]:
    """Every module that a file imports anywhere, dotted, with the names taken from it."""
    out = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are absolute"
            out |= {f"{node.module}.{alias.name}" for alias in node.names}
    return out


def test_pcalib_never_imports_mujoco_or_bench():
    for file in (ROOT / "pcalib").rglob("*.py"):
        bad = {name for name in imported(file) if name.split(".")[0] in ("mujoco", "bench")}
        assert not bad, f"{file}: {bad}"


def bench_files():
    return [f for f in (ROOT / "bench").rglob("*.py") if "jobs" not in f.relative_to(ROOT).parts]


def test_the_virtual_robot_takes_only_descriptions_and_files():
    assert len(bench_files()) > 5
    for file in bench_files():
        allowed = SHARED | {"cli"} if file.parent.name == "cli" else SHARED
        for name in imported(file):
            parts = name.split(".")
            if parts[0] == "pcalib":
                assert {parts[1], ".".join(parts[1:3])} & allowed, f"{file} imports {name}"
            # The program's commands may start jobs, which put both sides together; the robot itself may not.
            assert parts[:2] != ["bench", "jobs"] or file.parent.name == "cli", f"{file} imports {name}"


def test_the_virtual_robot_asks_a_mechanism_for_names_and_values_only():
    for file in bench_files():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and node.attr in NOT_OF_A_ROBOT:
                of = ast.unparse(node.value).rpartition(".")[2]
                assert of != "mechanism", f"{file}:{node.lineno}: mechanism.{node.attr}"


@pytest.mark.parametrize("module", ["pcalib", "pcalib.robot", "pcalib.data.measurement", "pcalib.cli"])
def test_importing_the_core_loads_no_mujoco(module):
    code = f"import sys, {module}; sys.exit(any(m.split('.')[0] in ('mujoco', 'bench') for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
