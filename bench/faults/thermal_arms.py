"""Arms that grow with temperature."""

from __future__ import annotations

from bench.faults._growth import Growth, expansion


class ThermalArms(Growth):
    """The arms grow from their motor axes: every elbow point moves out by α·(T − 20 °C). Aluminium: 23.6 ppm/K."""

    LETTER, PART = "a", "arms"
    ROTARY = True
    NEEDS = ("temp_arms",)
    MJCF = "positions of the rod bodies in the arms"
    SETTINGS = expansion(2.36e-05)


FAULT = ThermalArms
