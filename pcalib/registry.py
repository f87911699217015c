"""Kinds, effects, faults and the like: one module of a package each, which the package finds by itself."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

from pcalib.errors import InputError, PcalibError, unknown

T = TypeVar("T")


@dataclass(frozen=True)
class Registry(Generic[T]):
    """The modules of a package; each one defines the same attribute. Names that begin with _ are helpers."""

    package: str
    attribute: str
    """What each module defines: KIND, EFFECT, FAULT."""
    what: str
    """The thing in words, for messages."""
    key: str | None = None
    """The key of a file that names one, for messages."""
    remedy: str = ""
    error: type[PcalibError] = InputError
    helpers: tuple[str, ...] = ()
    """Further modules that define no such thing."""
    separator: str = "_"
    """What stands in names where module names have _."""

    @cached_property
    def _modules(self) -> dict[str, str]:
        """Module of each name, sorted."""
        path = importlib.import_module(self.package).__path__
        found = sorted(m.name for m in pkgutil.iter_modules(path) if m.name[0] != "_" and m.name not in self.helpers)
        return {module.replace("_", self.separator): module for module in found}

    def names(self) -> list[str]:
        """The names that exist, sorted."""
        return list(self._modules)

    def get(self, name: str) -> T:
        """The one of that name.

        Raises:
            PcalibError: there is none of that name; the message lists the accepted ones.
        """
        if name not in self._modules:
            problem = unknown(self.what, name, self.names())
            if self.error is InputError:
                raise InputError(problem, key=self.key, remedy=self.remedy)
            raise self.error(problem + (f"\n  {self.remedy}" if self.remedy else ""))
        return vars(importlib.import_module(f"{self.package}.{self._modules[name]}"))[self.attribute]
