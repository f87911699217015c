"""The set-up script: what it says where it cannot work, and that it does nothing twice."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = [f for f in (ROOT / "scripts").iterdir() if f.is_file() and b"bash" in f.read_bytes()[:40]]
TOOLS = ("env", "bash", "dirname", "cat", "rm", "grep", "tee", "tail", "awk", "tr")

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")


def program(path: Path, lines: str) -> None:
    path.write_text("#!/bin/bash\n" + lines)
    path.chmod(0o755)


@pytest.fixture
def project(tmp_path) -> Path:
    """Scripts, lock and project file in a folder of their own; a PATH with basic tools only."""
    root = tmp_path / "a project"
    (root / "scripts").mkdir(parents=True)
    for name in ("setup", "demo"):
        shutil.copy(ROOT / "scripts" / name, root / "scripts")
    (root / "requirements.lock").write_text("one==1\ntwo==2\n")
    (root / "pyproject.toml").write_text("[project]\n")
    (root / "bin").mkdir()
    for tool in TOOLS:
        found = shutil.which(tool)
        if found:
            (root / "bin" / tool).symlink_to(found)
    return root


def run(project: Path, script: str = "setup", **environment: str) -> subprocess.CompletedProcess:
    path = {"PATH": str(project / "bin"), "HOME": os.environ.get("HOME", "/")}
    return subprocess.run(
        [project / "scripts" / script], env=path | environment, capture_output=True, text=True, check=False, timeout=60
    )


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda f: f.name)
def test_scripts_are_bash(script):
    assert subprocess.run(["bash", "-n", script], check=False).returncode == 0


def test_an_old_python_is_said_so(project):
    program(project / "bin" / "python3", '[ "$1" = --version ] && echo "Python 3.9.2" && exit 0\nexit 1\n')
    done = run(project, "demo")
    assert done.returncode == 2 and done.stdout == ""
    assert "python 3.11 or newer is needed" in done.stderr and "Python 3.9.2" in done.stderr
    assert not (project / ".venv").exists()


FAKE = """
log="{log}"
echo "$*" >>"$log"
case "$*" in
    *version_info*) exit 0 ;;
    "-m venv "*) for last; do :; done; /bin/mkdir -p "$last/bin" && /bin/cp "$0" "$last/bin/python" ;;
    "-m pip --version") exit 0 ;;
    "-m pip install --require-hashes "*) {install} ;;
    "-m pip install --no-deps "*) exit 0 ;;
    *hashlib*) echo fingerprint ;;
esac
"""


def test_it_installs_once(project, tmp_path):
    log = tmp_path / "log"
    program(project / "bin" / "python3", FAKE.format(log=log, install="echo Collecting one; exit 0"))
    done = run(project)
    assert done.returncode == 0, done.stderr
    calls = log.read_text()
    assert "-m pip install --require-hashes -r" in calls
    assert "-m pip install --no-deps --no-build-isolation -e" in calls
    log.write_text("")
    assert run(project).returncode == 0
    assert "pip" not in log.read_text() and "venv" not in log.read_text()


def test_a_failed_installation_is_shown_and_tried_again(project, tmp_path):
    log = tmp_path / "log"
    program(project / "bin" / "python3", FAKE.format(log=log, install='echo "hashes do not match"; exit 1'))
    done = run(project)
    assert done.returncode == 2
    assert "hashes do not match" in done.stderr and "could not be installed" in done.stderr
    assert run(project).returncode == 2
    assert log.read_text().count("--require-hashes") == 2


def test_the_lock_is_hashed_throughout_and_names_no_index():
    lock = (ROOT / "requirements.lock").read_text()
    assert not re.search(r"https?://|--(extra-)?index-url|--find-links|--trusted-host", lock)
    for block in re.split(r"\n(?=[a-z0-9])", lock):
        if "==" in block.splitlines()[0]:
            assert "--hash=sha256:" in block, block.splitlines()[0]
