"""A wheel builds with and without a C compiler, installs in an empty environment, and finds robots by their names."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NEEDED = ("bench", "models", "native", "pcalib", "MANIFEST.in", "README.md", "LICENSE", "pyproject.toml", "setup.py")
CLEAN = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PCALIB_NATIVE", "CC")}


def run(*command: object, **environment: str) -> str:
    done = subprocess.run([*map(str, command)], env=CLEAN | environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("compiler", [None, "false"], ids=["compiler", "none"])
def test_a_wheel_in_an_empty_environment(compiler, tmp_path):
    pytest.importorskip("setuptools")
    pytest.importorskip("pip")
    if compiler is None and not (shutil.which("cc") or shutil.which("gcc")):
        pytest.skip("no C compiler (cc, gcc) on this machine")
    source, ignored = tmp_path / "source", shutil.ignore_patterns("__pycache__", "*.so", "*.pyd", "*.egg-info")
    source.mkdir()
    for name in NEEDED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, source / name, ignore=ignored)
        else:
            shutil.copy(ROOT / name, source / name)
    pip = [sys.executable, "-m", "pip"]
    offline = ["--no-deps", "--no-index", "--disable-pip-version-check", "-q"]
    environment = {} if compiler is None else {"CC": compiler}
    run(*pip, "wheel", *offline, "--no-build-isolation", "-w", tmp_path, source, **environment)
    (wheel,) = tmp_path.glob("*.whl")
    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "env")
    python = tmp_path / "env" / "bin" / "python"
    run(*pip, "--python", python, "install", *offline, wheel)
    site = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    Path(site, "needed.pth").write_text(sysconfig.get_path("purelib") + "\n")  # what pcalib needs, nothing downloaded
    program = tmp_path / "env" / "bin" / "pcalib"
    said = run(program, "--version")
    # a compiler that is there may be one that cannot build the extension, and that is no fault
    built = bool(list(Path(site, "pcalib").glob("_native*")))
    assert built <= (compiler is None) and ("NumPy" in said or built)
    run(program, "plan", "--robot", "delta", "-n", "30", "-o", tmp_path / "plan.csv")
    assert (tmp_path / "plan.csv").read_text().count("\n") > 30
