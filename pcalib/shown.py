"""How notebooks show a result: as its report does, in place of the names of its fields."""

from __future__ import annotations

from typing import Any, ClassVar


class Shown:
    """Base of results that notebooks show."""

    notebook: ClassVar[staticmethod[[], Any]]
    """Imports `pcalib.notebook`. The package sets it: results know nothing of the reports that are made of them."""

    def _repr_html_(self) -> str:
        return self.notebook().html(self)


class Tabled(Shown):
    """Base of results that are a table."""

    def to_arrow(self) -> Any:
        """The table as a `pyarrow.Table`, columns as in a file: the unit at the end of the name."""
        return self.notebook().arrow(self)

    def to_pandas(self) -> Any:
        """The table as a `pandas.DataFrame`; pandas must be there."""
        return self.to_arrow().to_pandas()
