"""How notebooks show a result: as its report does, in place of the names of its fields."""

from __future__ import annotations

import importlib
from typing import Any


def _notebook() -> Any:
    # Results know nothing of reports, which are made of them: reports are looked up when they are asked for.
    return importlib.import_module("pcalib.notebook")


class Shown:
    """Base of results that notebooks show."""

    def _repr_html_(self) -> str:
        return _notebook().html(self)


class Tabled(Shown):
    """Base of results that are a table."""

    def to_arrow(self) -> Any:
        """The table as a `pyarrow.Table`, columns as in a file: the unit at the end of the name."""
        return _notebook().arrow(self)

    def to_pandas(self) -> Any:
        """The table as a `pandas.DataFrame`; pandas must be there."""
        return self.to_arrow().to_pandas()
