"""Writing a recording: one stream per file, whole or not at all, complete with its footer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcalib.errors import InputError

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

APPLICATION = "pcalib"
TIMELINE = "model"
"""The timeline that every recording has: one step per model."""
_INSTALL = "pip install 'rerun-sdk==0.41.*'"


def sdk() -> Any:
    """The rerun module, set so that a bad argument is an error and not lost data.

    Raises:
        InputError: rerun is not installed, or another version than this project is made for.
    """
    try:
        import rerun
    except ImportError:
        raise InputError("the viewer is not installed", remedy=_INSTALL) from None
    if not rerun.__version__.startswith("0.41."):
        raise InputError(f"rerun {rerun.__version__} is installed, 0.41 is needed", remedy=_INSTALL)
    rerun.set_strict_mode(True)
    return rerun


@contextmanager
def recording(path: str | Path, blueprint: rrb.Blueprint, identity: str) -> Iterator[rr.RecordingStream]:
    """A stream into a new .rrd file that takes its place at `path` when the block ends well."""
    from pcalib import files

    rr = sdk()
    with files.atomic(path) as temporary:
        stream = rr.RecordingStream(APPLICATION, recording_id=identity)
        stream.set_log_time_enabled(False)  # the same content gives the same recording
        stream.set_log_tick_enabled(False)
        # Collected in memory: where a disk is full, rerun's own file sink loses data or waits for ever.
        memory = stream.memory_recording()
        stream.send_blueprint(blueprint, make_active=True, make_default=True)
        try:
            yield stream
            temporary.write_bytes(memory.drain_as_bytes())
        finally:
            stream.disconnect()
