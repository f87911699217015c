"""The frame of the command lines, on a program of its own and on the real ones: exit codes, messages, speed."""

import importlib
import inspect
import io
import json
import math
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pcalib.cli import _printing, frame
from pcalib.cli._inputs import EffectFiles

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent

COMMANDS = {
    "add_up": '''"""Add numbers up.

    toy add-up 1 2
"""
from typing import Annotated
import numpy as np
from pcalib.cli.frame import JsonOption, quantity, write_json

def command(*numbers: int, tool: Annotated[np.ndarray | None, quantity("length", 3)] = None, json: JsonOption = None):
    """Add numbers up.

    All of them [at once].

    Args:
        numbers: What to add.
    """
    write_json(json, {"sum": sum(numbers), "tool": tool})
    print("sum", sum(numbers), None if tool is None else tool.tolist())
''',
    "verify": '"""A check that does not hold."""\ndef command() -> int:\n    return 1\n',
    "refuse": '"""Bad input."""\nfrom pcalib.errors import InputError\ndef command():\n'
    '    raise InputError("bad", file="f.csv", line=3, column="x_mm", remedy="do better")\n',
    "full": '"""No space."""\ndef command():\n    raise OSError(28, "No space left on device", "out.csv")\n',
    "stop": '"""Ctrl-C."""\ndef command():\n    raise KeyboardInterrupt\n',
    "broken": '"""Imports nothing useful, which must not matter to the others."""\nimport does_not_exist_anywhere\n',
    "_hidden": "raise RuntimeError\n",
}


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A program with the commands above, as a function of its arguments."""
    folder = tmp_path / "toy_commands"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    for name, text in COMMANDS.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [m for m in sys.modules if m.split(".")[0] == "toy_commands"]:
        monkeypatch.delitem(sys.modules, name)
    return lambda *argv: frame.run(frame.app("toy", "toy_commands", [str(folder)], "A toy."), argv)


def test_a_file_is_a_command_and_none_is_imported_for_the_list(toy, capsys):
    assert toy("--help") == 0
    out = capsys.readouterr().out
    for name in ("add-up", "verify", "refuse", "stop", "broken"):
        assert name in out
    assert "Add numbers up." in out and "hidden" not in out
    assert not [m for m in sys.modules if m.startswith("toy_commands.")]


def test_help_of_a_command_has_its_text_and_examples(toy, capsys):
    assert toy("add-up", "--help") == 0
    out = capsys.readouterr().out
    assert "All of them [at once]." in out and "What to add." in out and "Examples:\n  toy add-up 1 2" in out
    assert "Args:" not in out


def test_help_shows_defaults_that_are_something(tmp_path, monkeypatch, capsys):
    """No '[default: ()]' beside an option that may be given several times."""
    (tmp_path / "shown.py").write_text(
        '"""Show."""\ndef command(*, tool: tuple[str, ...] = (), name: str = "", robot: str | None = None,'
        " poses: int = 7, exact: bool = False):\n    pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    for program in (frame.app("toy", "", [], "A toy."), None):
        if program is None:
            import shown

            assert frame.script("shown", shown.command, ["--help"]) == 0
        else:
            program.command("shown:command", name="shown")
            assert frame.run(program, ["shown", "--help"]) == 0
        out = capsys.readouterr().out
        assert "--tool" in out and "[default: 7]" in out and "[default: False]" in out and out.count("default:") == 2


def test_arguments_reach_the_command(toy, capsys, tmp_path):
    out = tmp_path / "out.json"
    assert toy("add-up", "1", "2", "--tool", "-10,0,-300mm", "--json", str(out)) == 0
    assert capsys.readouterr().out == "sum 3 [-0.01, 0.0, -0.3]\n"
    assert json.loads(out.read_text()) == {"sum": 3, "tool": [-0.01, 0.0, -0.3]}


@pytest.mark.parametrize(
    ("argv", "code", "message"),
    [
        (["verify"], 1, ""),
        (["refuse"], 2, "error: f.csv:3: column 'x_mm': bad\n  do better\n"),
        (["full"], 2, "error: out.csv: No space left on device\n"),
        (["stop"], 130, "interrupted\n"),
        (["ad-up"], 2, "error: unknown command 'ad-up' (did you mean 'add-up'?)"),
        (["--colour"], 2, "error: unknown option '--colour'\n  see toy --help\n"),
        (["verify", "more"], 2, "error: unexpected argument 'more'\n  see toy verify --help\n"),
        (["add-up", "--colour"], 2, "error: "),
        (["add-up", "one"], 2, "error: "),
        (["add-up", "--tool"], 2, "error: "),
        (["add-up", "--tool", "1,2,3"], 2, "error: --tool '1,2,3': no unit\n"),
        (["add-up", "--tool", "1,2mm"], 2, "error: --tool '1,2mm' needs 3 numbers, not 2\n"),
        (["add-up", "--tool", "1,2,3deg"], 2, "error: --tool '1,2,3deg': unknown unit|no unit"),
        (["add-up", "--json", "/does/not/exist/out.json"], 2, "error: /does/not/exist/out.json: cannot write"),
    ],
    ids=str,
)
def test_exit_codes_and_messages(toy, capsys, argv, code, message):
    assert toy(*argv) == code
    err = capsys.readouterr().err
    assert err.startswith(message.split("|")[0]) if code else err == ""
    assert "Traceback" not in err and err.count("error:") == (code == 2)
    if code == 2 and "see toy" in err:
        assert len(err.splitlines()) == 2
    if argv[0] in ("ad-up", "--colour"):
        assert not [m for m in sys.modules if m.startswith("toy_commands.")]


def test_plain_is_json():
    value = {
        "a": np.array([1.0, np.nan, np.inf]), "b": np.float64("nan"), "c": np.int64(3), "d": (True, np.bool_(True)),
        "e": {"f": Path("x/y"), 1: {2}}, "g": math.inf,
    }  # fmt: skip
    expected = {"a": [1.0, None, None], "b": None, "c": 3, "d": [True, True], "e": {"f": "x/y", "1": [2]}, "g": None}
    assert json.loads(json.dumps(frame.plain(value), allow_nan=False)) == expected
    with pytest.raises(TypeError):
        json.dumps(frame.plain({"a": object()}))


def test_json_is_whole_or_not_at_all(tmp_path):
    path = tmp_path / "out.json"
    frame.write_json(path, {"good": 1})
    with pytest.raises(TypeError):
        frame.write_json(path, {"bad": object()})
    assert json.loads(path.read_text()) == {"good": 1} and os.listdir(tmp_path) == ["out.json"]


def test_tables_keep_every_character(capsys):
    frame.show_table(("name", "µm"), [("[geometry]", "-1.50"), ("x" * 300, "12"), (None, "−3")], title="[bold]Title")
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == "[bold]Title"
    assert any("[geometry]" in line and line.endswith("-1.50") for line in lines)
    assert any("x" * 300 in line and line.endswith("   12") for line in lines)


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("stream", "after", "shown"), [(Terminal, 0.0, True), (Terminal, 60.0, False), (io.StringIO, 0.0, False)]
)
def test_progress_shows_only_on_a_terminal_and_only_for_long_work(monkeypatch, stream, after, shown):
    err = stream()
    monkeypatch.setattr(sys, "stderr", err)
    monkeypatch.setattr(_printing, "PROGRESS_AFTER", after)
    with frame.progress("working", 3) as advance:
        for _ in range(3):
            time.sleep(0.001)
            advance()
    assert ("working" in err.getvalue()) == shown
    assert shown or err.getvalue() == ""


def program(name):
    path = BIN / name
    if not path.exists():
        pytest.skip(f"{name} is not installed beside {sys.executable}")
    return str(path)


@pytest.mark.parametrize("name", ["pcalib", "pcbench"])
def test_installed_programs(name):
    def call(*argv):
        return subprocess.run([program(name), *argv], capture_output=True, text=True)

    helped = call("--help")
    assert helped.returncode == 0 and helped.stdout.startswith(f"Usage: {name}") and helped.stderr == ""
    for argv in (["no-such-command"], ["--no-such-option"]):
        wrong = call(*argv)
        assert wrong.returncode == 2 and wrong.stdout == "" and wrong.stderr.startswith("error: ")
        assert "Traceback" not in wrong.stderr
    assert call("--version").returncode == 0


@pytest.mark.parametrize("folder", ["pcalib", "bench"])
def test_every_program_has_examples_and_every_command_json(folder, capsys):
    program = importlib.import_module(f"{folder}.cli")
    assert program.main(["--help"]) == 0
    assert "Examples:\n  pc" in capsys.readouterr().out
    for file in (ROOT / folder / "cli").glob("*.py"):
        if file.stem.startswith("_") or file.stem == "frame":
            continue
        command = importlib.import_module(f"{folder}.cli.{file.stem}").command
        options = inspect.signature(command, eval_str=True).parameters
        assert "json" in options, file.stem
        own = options.get("effect_file")
        assert own is None or own.annotation == EffectFiles, file.stem


def test_python_dash_m():
    done = subprocess.run([sys.executable, "-m", "pcalib", "--version"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.strip()


@pytest.mark.parametrize(("module", "forbidden"), [
    ("pcalib", "numpy scipy cyclopts rich"),
    ("pcalib.cli", "numpy scipy matplotlib pyarrow rerun"),
    ("pcalib.data.measurement", "scipy matplotlib pyarrow rerun cyclopts"),
])  # fmt: skip
def test_imports_stay_light(module, forbidden):
    code = f"import sys, {module}; sys.exit(str([m for m in {forbidden.split()} if m in sys.modules] or 0))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stderr.strip() in ("", "0")


def test_a_reader_that_goes_away_is_no_error(tmp_path):
    code = "import sys; from pcalib.cli import main; sys.exit(main(['--help']))"
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert done.returncode == frame.PIPE_CLOSED and done.stderr == ""


def test_ctrl_c_ends_with_130():
    code = (
        "import sys, time; from pcalib.cli import frame\n"
        "def wait(*a, **k):\n    print('waiting', flush=True); time.sleep(30)\n"
        "sys.exit(frame.run(wait, []))"
    )
    started = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert started.stdout is not None and started.stdout.readline() == "waiting\n"
    started.send_signal(signal.SIGINT)
    _, err = started.communicate(timeout=300)
    assert started.returncode == 130 and err == "interrupted\n"


def test_on_a_terminal_lines_are_wrapped_between_words():
    """A pseudo-terminal of 60 columns."""
    code = "from pcalib.cli.frame import say; say('- warning: ' + 'word ' * 30)"
    lead, follow = pty.openpty()
    env = os.environ | {"COLUMNS": "60", "TERM": "xterm"}
    done = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=follow, stdin=follow, env=env)
    done.wait(timeout=300)
    os.close(follow)
    text = os.read(lead, 10_000).decode()
    os.close(lead)
    lines = text.replace("\r", "").strip().split("\n")
    assert len(lines) > 2 and all(len(line) <= 60 for line in lines)
    assert all(line.startswith("  word") for line in lines[1:])


def test_a_table_that_is_too_wide_is_shown_row_by_row(monkeypatch):
    """Names that the next command needs are never cut, and nothing is wider than the terminal."""
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setattr(sys, "stdout", Terminal())
    rows = [("encoder_eccentricity", "33 %", "21.3", "compliance 39.9 µrad/N·m (drive stiffness 25.1 kN·m/rad)", "")]
    frame.show_table(("effect", "visible", "s", "fitted alone", "note"), rows)
    lines = [line.strip() for line in sys.stdout.getvalue().splitlines() if line.strip()]
    assert lines[0] == "encoder_eccentricity" and max(map(len, lines)) <= 60
    assert " ".join(lines[1:]).startswith("visible 33 %; s 21.3; fitted alone compliance 39.9 µrad/N·m")
    frame.show_table(("effect", "visible"), rows=[("encoder_eccentricity_of_all_arms", "x " * 40)])
    assert "encoder_eccentricity_of_all_arms" in sys.stdout.getvalue()
