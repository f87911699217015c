"""A command of the workbench in a process of its own, which ends when the workbench does, however that ended.

python -m pcalib.workbench.child fit data.csv --robot robot.toml
"""

from __future__ import annotations

import os
import runpy
import threading


def _end_with_the_parent() -> None:
    """Wait for the end of standard input, which the workbench holds open as long as it lives."""
    while os.read(0, 4096):
        pass
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    runpy.run_module("pcalib", run_name="__main__")
