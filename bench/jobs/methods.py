"""The ways to calibrate a robot that demo, campaigns and studies compare: one ladder, from the drawing upwards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pcalib import effects
from pcalib.data.measurement import Measurements
from pcalib.fitting import identification
from pcalib.fitting.identification import Fit
from pcalib.model import FittedEffect, Model
from pcalib.robot import Robot

READS = ("pose", "position", "x")
"""What a method uses of the data: all, positions alone, or their x alone (equation 38 of the paper knows no more)."""
_SEEN = {"pose": [True] * 6, "position": [True] * 3 + [False] * 3, "x": [True] + [False] * 5}


@dataclass(frozen=True)
class Method:
    """One way to calibrate a robot and to command it."""

    name: str
    """Short and stable, for files and tables."""
    level: str = "complete"
    """Geometry level; 'nominal' identifies nothing."""
    fit: str = "map"
    """How the level is identified, one of `identification.METHODS`."""
    compensation: str = "exact"
    """How commands are found, one of `compensation.METHODS`."""
    loss: str = "linear"
    weighted: bool = True
    """Whether residuals are divided by the instrument's σ."""
    reads: str = "pose"
    effects: tuple[str, ...] = ()
    """Effects that are identified too, by their names."""
    fixed: tuple[str, ...] = ()
    """Parameters that are held at nominal."""
    label: str = ""
    """For people."""
    text: str = ""
    """What is done, beside what the level lets vary."""

    @property
    def identifies(self) -> bool:
        """Whether the method makes any use of data."""
        return self.level != "nominal" or bool(self.effects)

    def identify(self, data: Measurements, robot: Robot) -> Fit:
        """The fit to data.

        Raises:
            FitError: the fit did not converge, or the data cannot support the level.
        """
        if self.reads != "pose":
            data = replace(data, mask=data.mask & np.array(_SEEN[self.reads]))
        started = []
        for spec in self.effects:
            effect = effects.parse(spec, robot)
            started.append(FittedEffect(effect, np.zeros(len(effect.parameters)), spec))
        return identification.fit(
            data, robot, self.level, effects=started, method=self.fit, loss=self.loss, weighted=self.weighted,
            fixed=self.fixed or None,
        )  # fmt: skip

    def model(self, data: Measurements, robot: Robot) -> Model:
        """The model that the method makes of data."""
        return self.identify(data, robot).model if self.identifies else Model.nominal(robot)


LADDER = (
    Method(
        "nominal", "nominal", label="Nominal", text="The robot as drawn: whatever is wrong with it shows at the TCP."
    ),
    Method("classical", "classical", "base", label="Classical"),
    Method("model24", "model24", "base", label="Model 24"),
    Method(
        "paper", "complete", "linear", "first-order", label="Paper, linear",
        text="Found by one linear step; commands corrected to first order, as in the paper. What is left is of second "
        "order in the errors.",
    ),
    Method(
        "complete", label="Complete",
        text="Found by non-linear least squares with manufacturing tolerances as priors; commands from the exact "
        "inverse. What is left is what the instrument cannot resolve.",
    ),
)  # fmt: skip
"""The usual methods; 'paper' is the linear step of Savoure et al."""
BY_NAME: Mapping[str, Method] = {method.name: method for method in LADDER}
