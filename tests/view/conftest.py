"""Reading recordings back."""

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def read() -> Callable[[Path, str], dict[int | None, dict[str, list]]]:
    """read(file, entity) → step (None: static) → component → values of that one log call."""

    def make(path: Path, entity: str) -> dict[int | None, dict[str, list]]:
        from rerun.chunk import RrdReader

        out: dict[int | None, dict[str, list]] = {}
        for chunk in RrdReader(path).stream().filter(content=f"/{entity}"):
            batch = chunk.to_record_batch()
            names = batch.schema.names
            for row in range(batch.num_rows):
                step = batch.column("model")[row].as_py() if "model" in names else None
                at = out.setdefault(step, {})
                for name in names:
                    if ":" in name and (value := batch.column(name)[row].as_py()) is not None:
                        at[name.split(":")[1]] = value
        return out

    return make


@pytest.fixture
def entities() -> Callable[[Path], set[str]]:
    """entities(file) → entity paths of the recording."""

    def make(path: Path) -> set[str]:
        from rerun.chunk import RrdReader

        return {str(chunk.entity_path) for chunk in RrdReader(path).stream()}

    return make


@pytest.fixture
def hostile() -> str:
    """A name that breaks whatever is not escaped."""
    return '<script>alert("x")</script> & | `*_#[a](b) \'$&'
