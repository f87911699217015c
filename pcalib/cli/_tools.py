"""The option --tool where it may be given several times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from pcalib.robot import Robot

ToolsOption = Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True, negative=())]


def tool_options(texts: Sequence[str], robot: Robot | None = None) -> list[np.ndarray]:
    """TCPs in the plate frame (3,) [m] from texts such as '0,0,-300mm'.

    Raises:
        InputError: not three numbers with a unit of length, or, with a robot, a tool far longer than it.
    """
    from pcalib import units
    from pcalib.errors import InputError

    tools = [units.parse_quantity(text, "length", option="--tool") for text in texts]
    for text, tool in zip(texts, tools, strict=True):
        if len(tool) != 3:
            raise InputError(f"--tool '{text}' needs 3 numbers, not {len(tool)}", remedy="for example 0,0,-300mm")
        if robot is not None:
            require_tool(robot, tool, f"--tool '{text}'")
    return tools


def require_tool(robot: Robot, tool: np.ndarray, said: str) -> None:
    """Refuse a tool (3,) [m] that is too long to be meant.

    Raises:
        InputError: it is several times longer than the robot is large.
    """
    from pcalib.data.plausibility import too_long
    from pcalib.errors import InputError

    if too_long(robot, tool):
        raise InputError(f"{said}: longer than the robot is large", remedy="check its unit")
