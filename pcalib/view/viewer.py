"""Opening recordings in the Rerun viewer, as a window or in the browser."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

from pcalib.errors import InputError
from pcalib.view.recording import sdk


def recording_of(run: Path) -> Path:
    """The recording that `run` means: the file itself, or the only .rrd of a folder.

    Raises:
        InputError: no such file or folder, or a folder with no recording or several.
    """
    if run.is_file():
        with run.open("rb") as file:
            if not file.read(4).startswith(b"RRF"):
                raise InputError(
                    "this is no recording (.rrd), and no model file (.toml) either", file=run,
                    remedy="name what 'pcalib fit -o' or 'pcbench demo' wrote",
                )  # fmt: skip
        return run
    if not run.exists():
        raise InputError("no such file or folder", file=run, remedy="check the path; 'pcbench demo' makes out/demo")
    found = sorted(run.glob("*.rrd"))
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError("no recording (.rrd) in this folder", file=run, remedy="name one that a command has written")
    raise InputError(
        f"{len(found)} recordings in this folder", file=run, remedy=f"name one: {', '.join(f.name for f in found)}"
    )


def show(recording: Path, browser: bool = False) -> None:
    """Open a recording and wait until the viewer is closed.

    Raises:
        InputError: there is no screen, or the viewer does not start.
    """
    options = ["--web-viewer", "--web-viewer-port", "0"] if browser else []
    if not browser:
        _need_a_screen()
    program = _program()
    try:
        words = [program, "--bind", "127.0.0.1", "--port", "auto", *options, str(recording)]
        code = subprocess.run(words, check=False).returncode
    except OSError as error:
        raise InputError(f"the viewer cannot be started: {error.strerror}", file=program) from None
    if code > 0:
        raise InputError(f"the viewer ended with an error (exit code {code})", file=recording)


class Live:
    """A window of the viewer that stays open and takes one recording after the other."""

    def __init__(self, *options: str) -> None:
        """Open it.

        Raises:
            InputError: there is no screen, or the viewer does not start.
        """
        if not options:
            _need_a_screen()
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        self._words = [str(_program()), "--bind", "127.0.0.1", "--port", str(self.port)]
        self._process = subprocess.Popen([*self._words, "--hide-welcome-screen", *options])

    def open(self) -> bool:
        """Whether it has not been closed."""
        return self._process.poll() is None

    def take(self, recording: Path) -> None:
        """Show a recording; the last one stays open beside it.

        Raises:
            InputError: the viewer ended before it could show anything.
        """
        while self.open():
            try:
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
            except OSError:
                time.sleep(0.1)
            else:
                subprocess.run([*self._words, str(recording)], check=False, capture_output=True)
                return
        if self._process.returncode > 0:
            raise InputError(f"the viewer ended with an error (exit code {self._process.returncode})")

    def close(self) -> None:
        """Close the window."""
        self._process.terminate()
        self._process.wait()


def _program() -> Path:
    sdk()
    import rerun_cli

    return Path(rerun_cli.__file__).parent / ("rerun.exe" if sys.platform == "win32" else "rerun")


def _need_a_screen() -> None:
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            "there is no screen here to open the viewer on",
            remedy="add --browser, or --save FILE.rrd and open it elsewhere: rerun FILE.rrd",
        )
