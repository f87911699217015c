"""A viewer that follows a model file: every step that is made of it appears as it is made."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from pcalib import files, modelfile
from pcalib.ladder import Ladder
from pcalib.model import Model
from pcalib.view.story import write

PAUSE = 0.3
"""[s] Interval between two reads of the file: short enough for a step to appear at once."""


class Window(Protocol):
    """A window that shows recordings, such as `viewer.Live`."""

    def open(self) -> bool:
        """Whether it has not been closed."""
        ...

    def take(self, recording: Path) -> None:
        """Show a recording."""
        ...

    def close(self) -> None:
        """Close it."""
        ...


def follow(path: Path, window: Window, drawn: Callable[[Model], Ladder], effect_files: Sequence[str] = ()) -> None:
    """Show a model now and whenever its file has changed, until the window is closed.

    Args:
        drawn: what is shown of a model.
        effect_files: the user's own effects that may be loaded.

    Raises:
        InputError: the file is no model file any more.
    """
    seen = None
    with tempfile.TemporaryDirectory() as folder:
        try:
            while window.open():
                text = files.read_text(path)
                if text == seen:
                    time.sleep(PAUSE)
                    continue
                seen, model = text, modelfile.loads(text, path, effect_files)
                name = f"{path.stem}, step {len(model.history)}"
                write(Path(folder) / "now.rrd", drawn(model), model=model, identity=name, last=True)
                window.take(Path(folder) / "now.rrd")
        finally:
            window.close()
