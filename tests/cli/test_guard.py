"""The outermost guard: whatever a program meets, it ends with an exit code that means what it says."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pcalib import outputs
from pcalib.cli import _guard, _printing, frame
from pcalib.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
START = """
import sys
from pcalib import files
from pcalib.cli import frame
def work(*a, **k):
    {}
sys.exit(frame.run(work, []))
"""


def ends(code: str, stdout: int | None = subprocess.PIPE, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """A program whose work is one statement, as a process."""
    return subprocess.run(
        [sys.executable, "-c", START.format(code)], cwd=ROOT, stdout=stdout, stderr=subprocess.PIPE, check=False,
        env=os.environ | environment,
    )  # fmt: skip


@pytest.mark.parametrize("error", ["KeyError('kind')", "RecursionError()", "ZeroDivisionError()", "UnicodeError('µ')"])
def test_an_unforeseen_exception_is_3_with_a_file_to_send(error, tmp_path):
    done = ends(f"raise {error}", TMPDIR=str(tmp_path))
    said = done.stderr.decode()
    assert done.returncode == frame.UNFORESEEN and "Traceback" not in said and len(said.splitlines()) == 2
    (report,) = tmp_path.iterdir()
    assert str(report) in said and "Traceback" in report.read_text() and error.split("(")[0] in report.read_text()


def test_too_little_memory_is_bad_input():
    done = ends("raise MemoryError")
    assert done.returncode == 2 and b"more memory" in done.stderr


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "cp1252"])
def test_a_stream_without_a_character_degrades(encoding):
    done = ends("frame.say('21 µm, σ ≤ 3, Δ')", PYTHONIOENCODING=encoding)
    assert done.returncode == 0 and b"sigma <= 3, ?" in done.stdout and done.stderr == b""


@pytest.mark.parametrize("closed", ["stdout", "stderr"])
def test_closed_streams_do_not_matter(closed, tmp_path):
    """And no file that is opened later gets the number of a closed stream."""
    redirect = ">&-" if closed == "stdout" else "2>&-"
    code = START.format(f"files.write_text('{tmp_path}/new', 'x'); frame.say('said'); print('error', file=sys.stderr)")
    done = subprocess.run(["bash", "-c", f'exec "$0" -c "$1" {redirect}', sys.executable, code], cwd=ROOT, check=False)
    assert done.returncode == 0 and (tmp_path / "new").read_text() == "x"


def test_a_full_standard_output_is_said():
    with open("/dev/full", "w") as full:
        done = ends("frame.say('said')", stdout=full.fileno())
    assert done.returncode == 2 and b"No space left" in done.stderr and b"Traceback" not in done.stderr


@pytest.mark.parametrize("columns", ["0", "-5", "1", "x", "9" * 30])
def test_a_width_that_no_terminal_has_is_not_believed(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    _printing.believe_width()
    assert "COLUMNS" not in os.environ


def test_sigterm_leaves_nothing_half_written(tmp_path):
    code = START.format(
        f"files.check_folder('{tmp_path}')\n    with files.atomic_folder('{tmp_path}/out') as new:\n"
        "        (new / 'a').write_text('x'); print('waiting', flush=True); import time; time.sleep(60)"
    )
    started = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE)
    assert started.stdout is not None and started.stdout.readline() == b"waiting\n"
    started.send_signal(signal.SIGTERM)
    assert started.wait() == _guard.TERMINATED and not list(tmp_path.iterdir())


def test_what_a_killed_process_was_writing_is_swept(tmp_path):
    code = (
        f"from pcalib import files; import os\nwith files.atomic_folder('{tmp_path}/out') as new:\n"
        f"    (new / 'a').write_text('x')\n    with files.atomic('{tmp_path}/b'):\n        os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False)
    assert len(list(tmp_path.iterdir())) == 2
    (tmp_path / ".out.pcalib-00000000-1-x").write_text("another machine's")
    with outputs.atomic(tmp_path / "mine"):
        outputs.check_places(tmp_path / "b")
        assert len(list(tmp_path.iterdir())) == 2  # that of a process that runs stays


def test_names_cannot_act_on_the_terminal_and_messages_have_an_end(capsys):
    frame.say("robot \x1b[2J\x1b]0;x\x07 \u202eevil")
    frame.show_table(["a\x1b[1m"], [["\x9b31m"]], title="t\x1b")
    frame.fail("x" * 5000 + "\n" + "y\n" * 5000)
    out, err = capsys.readouterr()
    assert not set(out + err) & {"\x1b", "\x07", "\x9b", "\u202e"} and len(err) < 2000


def test_a_file_that_was_read_is_not_overwritten(tmp_path):
    """Not even one that no option names, such as the robot of a truth file."""
    from pcalib import files

    (tmp_path / "robot.toml").write_text("precious")
    with files.keeping_inputs():
        files.read_text(tmp_path / "robot.toml")
        with pytest.raises(InputError, match="is read, and would be overwritten"):
            files.write_text(tmp_path / "robot.toml", "new")
        with pytest.raises(InputError, match="is read"), files.atomic_folder(tmp_path) as folder:
            (folder / "robot.toml").write_text("new")
        files.may_rewrite([tmp_path / "robot.toml"])
        files.write_text(tmp_path / "robot.toml", "new")
    assert (tmp_path / "robot.toml").read_text() == "new"


def test_names_that_are_not_utf8(tmp_path):
    name = os.fsdecode(b"\xff\xfe.json")
    frame.write_json(tmp_path / name, {"data": Path(name)})
    assert (tmp_path / name).read_text() == '{\n  "data": "\\udcff\\udcfe.json"\n}\n'
    assert ends(f"raise files.InputError('absent', file={name!r})").returncode == 2
