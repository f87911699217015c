"""The option --tool where it may be given several times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from cyclopts import Parameter

ToolsOption = Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True, negative=())]


def tool_options(texts: Sequence[str]) -> list[np.ndarray]:
    """TCPs in the plate frame (3,) [m] from texts such as '0,0,-300mm'.

    Raises:
        InputError: not three numbers with a unit of length.
    """
    from pcalib import units
    from pcalib.errors import InputError

    tools = [units.parse_quantity(text, "length", option="--tool") for text in texts]
    for text, tool in zip(texts, tools, strict=True):
        if len(tool) != 3:
            raise InputError(f"--tool '{text}' needs 3 numbers, not {len(tool)}", remedy="for example 0,0,-300mm")
    return tools
