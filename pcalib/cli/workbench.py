"""The calibration loop in a window of the browser: fit, compare, see where, learn what, add, watch the error fall.

pcalib workbench
pcalib workbench data.csv --robot robot.toml
pcalib workbench --folder session
"""

from __future__ import annotations

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
        port: Port of the page; a free one when absent.
        no_browser: Open no browser.
    """
    import webbrowser

    from pcalib.errors import InputError
    from pcalib.workbench import server

    if (data is None) != (robot is None):
        raise InputError("data and robot file go together", remedy="name both, or none and drop them on the page")
    running, bench = server.serve(folder, port)
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
