"""Who may import whom: the core never sees MuJoCo, and the virtual robot never sees the core's formulas."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = {
    "errors", "units", "files", "settings", "registry", "robot", "rotation",
    "data.measurement", "data.instrument", "data.readings", "data.columns", "data.table", "data.plausibility",
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


def modules() -> dict[str, Path]:
    """Every module of the project by its dotted name."""
    files = [file for top in ("pcalib", "bench") for file in (ROOT / top).rglob("*.py")]
    return {".".join(f.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


def room(module: str, files: dict[str, Path]) -> str:
    """The folder of a module; a file right under pcalib/ or bench/ is a room of its own."""
    folder = module.rpartition(".")[0]
    return module if files[module].name == "__init__.py" or folder in ("", "pcalib", "bench") else folder


def circles(arrows: dict[str, set[str]]) -> dict[str, list[str]]:
    """The nodes from which a walk along the arrows comes back, each with its next steps on such walks."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        while more := {end for node in (seen or {start}) for end in arrows.get(node, ())} - seen:
            seen |= more
        return seen

    far = {node: reached(node) for node in arrows}
    return {
        node: sorted(end for end in ends if end == node or node in far.get(end, ()))
        for node, ends in arrows.items()
        if node in far[node]
    }


@pytest.mark.parametrize("by", ["file", "folder"])
def test_arrows_lead_down_and_never_in_a_circle(by):
    """Imports inside functions and for type checkers count too."""
    files = modules()
    arrows: dict[str, set[str]] = {}
    for module, file in files.items():
        source = module if by == "file" else room(module, files)
        for name in imported(file):
            while name and name not in files:
                name = name.rpartition(".")[0]
            target = name if by == "file" or not name else room(name, files)
            if target and target != source:
                arrows.setdefault(source, set()).add(target)
    assert not circles(arrows)


def test_public_names_are_there():
    import pcalib

    assert {*pcalib._PUBLIC, "__version__"} == set(dir(pcalib))
    assert all(getattr(pcalib, name) is not None for name in dir(pcalib))
    with pytest.raises(AttributeError, match=r"public names: .*load_robot"):
        pcalib.calibrate  # noqa: B018
