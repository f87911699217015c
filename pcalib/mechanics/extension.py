"""The optional extension in C: whether it was built and is wanted. Without NumPy, so that asking is quick."""

from __future__ import annotations

import ctypes
import os
from functools import cache
from importlib import util

VARIABLE = "PCALIB_NATIVE"
"""Environment variable that leaves everything to NumPy where it is 0."""


def library() -> ctypes.PyDLL | None:
    """The extension; None where it was not built, cannot run on this processor, or is not wanted."""
    return None if os.environ.get(VARIABLE) == "0" else _built()


@cache
def _built() -> ctypes.PyDLL | None:
    spec = util.find_spec("pcalib._native")
    if spec is None or spec.origin is None:
        return None
    try:
        found = ctypes.PyDLL(spec.origin)
        return found if found.three_arms_runs_here() else None
    except (OSError, AttributeError):  # of another platform or version
        return None


def about() -> str:
    """Which kinematics runs, in words."""
    if library() is not None:
        return "kinematics in C"
    return "kinematics in NumPy" + (f", as {VARIABLE}=0 says" if os.environ.get(VARIABLE) == "0" else "")
