"""Recordings for the Rerun viewer: the robot, its error field, and how both change from model to model.

The viewer's SDK is imported only when something is written or shown.
"""

from __future__ import annotations

from pcalib.view.story import write as write

__all__ = ["write"]
