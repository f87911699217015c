"""The calibration loop in a window of the browser: fit, compare, see where, learn what, add, watch the error fall.

pcalib workbench
pcalib workbench data.csv --robot robot.toml
pcalib workbench --folder session
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from pcalib.cli.frame import JsonOption, Writes, say, write_json


def command(
    data: Path | None = None,
    /,
    *,
    robot: Path | None = None,
    folder: Annotated[Path, Writes(folder=True)] = Path("workbench"),
    host: str = "",
    password_file: Path | None = None,
    port: Annotated[int, Parameter(validator=Number(gte=0, lt=65536))] = 0,
    no_browser: bool = False,
    json: JsonOption = None,
) -> int | None:
    """The calibration loop in a window of the browser: fit, compare, see where, learn what, add, watch the error fall.

    Every click runs the command of that name in the folder of the session, where its files and the script of all
    commands are found. The page is served to this computer alone, under an address that nobody can guess.

    Args:
        data: Measurement file, CSV or Parquet; it can be dropped on the page as well.
        robot: Robot file; it can be dropped on the page as well.
        folder: Folder of the session; an earlier one goes on where it was.
        host: Address of this computer at which others may open the page too, in a network that you trust: nothing is
            encrypted. Needs a password.
        password_file: File whose first line is that password; it must be readable by you alone.
        port: Port of the page; a free one when absent.
        no_browser: Open no browser.
    """
    import webbrowser

    from pcalib.errors import InputError
    from pcalib.workbench import server

    if (data is None) != (robot is None):
        raise InputError("data and robot file go together", remedy="name both, or none and drop them on the page")
    running, bench = server.serve(folder, port, *_for_others(host, password_file))
    try:
        if data is not None and robot is not None:
            for path, role in ((robot, "robot"), (data, "data")):
                bench.take(path.name, path.read_bytes(), role)
            bench.go_on()
        where = server.address(running, bench)
        write_json(json, {"schema": "pcalib.workbench/1", "address": where, "folder": str(folder)})
        say(f"The workbench is at {where} until Ctrl-C ends it. Its files are in {folder}.")
        if not no_browser:
            webbrowser.open(where)
        running.serve_forever()
    finally:
        bench.worker.close()
        running.server_close()
    return None


SHORTEST = 12
"""Characters of a password below which it could be guessed by trying."""


def _for_others(host: str, password_file: Path | None) -> tuple[str, str]:
    """Address and password.

    Raises:
        InputError: one without the other, a file that others can read, or a short password.
    """
    from pcalib import files
    from pcalib.errors import InputError
    from pcalib.workbench.server import LOOPBACK

    if not host and password_file is None:
        return LOOPBACK, ""
    if not host or password_file is None:
        raise InputError(
            "--host and --password-file go together",
            remedy="write a password into a file that you alone can read (chmod 600), and name it with --password-file",
        )
    if host in ("0.0.0.0", "::"):
        remedy = "name the address of this computer"
        raise InputError(f"--host {host} is no address that a browser can open", remedy=remedy)
    said = files.read_text(password_file)
    if os.name == "posix" and password_file.stat().st_mode & 0o077:
        raise InputError("others can read the password", file=password_file, remedy=f"chmod 600 {password_file}")
    password = (said.splitlines() or [""])[0].strip()
    if len(password) < SHORTEST:
        problem = f"the password has fewer than {SHORTEST} characters"
        raise InputError(problem, file=password_file, remedy="take a longer one")
    return host, password
