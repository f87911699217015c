"""A hose or a cable pulls on the plate."""

from __future__ import annotations

import mujoco
import numpy as np

from bench.faults import Fault
from pcalib.settings import Setting


class Hose(Fault):
    """A spatial tendon from a point of the base to a point of the plate acts as a spring that only pulls.

    Its force is k·(length − rest length) where the tendon is stretched. The force does not move a rigid robot, so a
    hose needs a compliance beside it. Typical: 20–100 N/m, rest length 0.5 m.
    """

    MJCF = "a spatial tendon `hose` with `stiffness` and `springlength`"
    SETTINGS = (
        Setting("stiffness", "stiffness", low=0.0, high=1e4, typical=50.0, about="k"),
        Setting("rest_length", "length", 0.5, 0.0, 5.0, about="below which it hangs slack"),
        Setting("anchor", "length", np.array([0.25, 0.1, 0.0]), count=3, about="its upper end, base frame"),
        Setting("plate", "length", np.array([0.03, 0.0, 0.02]), count=3, about="its lower end, plate frame"),
    )
    loaded = True

    def build(self, spec: mujoco.MjSpec) -> None:
        self.body(spec, "base").add_site(name="hose.base", pos=self.values["anchor"])
        self.body(spec, "plate").add_site(name="hose.plate", pos=self.values["plate"])
        tendon = spec.add_tendon(name="hose", springlength=[0.0, self.values["rest_length"]])
        tendon.stiffness[0] = self.values["stiffness"]
        tendon.wrap_site("hose.base")
        tendon.wrap_site("hose.plate")


FAULT = Hose
