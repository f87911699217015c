"""Bed contacts: commands that are lowered until the tool touches a level bed.

What such a probe records is the command at which it triggered; the height it reads is that of the bed, exactly. Its
noise is a tip that stands a little above or below the bed when it triggers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.commands import Commands
from bench.machine import Machine
from bench.reach import reach
from bench.truth import Truth

STEPS = 4
"""Corrections of the height. Nominal and true robot differ by about a thousandth, so each correction leaves about a
thousandth of the miss before it."""


def lowered(truth: Truth, commands: Commands, seed: int) -> Commands:
    """Return the commands that touch the bed where the plate stands above it in the given ones; NaN where none does.

    As on a printer, the controller's own (nominal) model keeps the plate in place and changes its height.
    """
    instrument, nominal, machine = truth.instrument, Machine(truth.robot), truth.machine()
    start = nominal.run(commands)
    rows, flat = np.arange(len(commands)), np.zeros((len(commands), 3))
    noise = instrument.read(flat, np.broadcast_to(np.eye(3), (len(commands), 3, 3)), seed, rows).position[:, 2]
    wanted, x, q = instrument.values["bed"] + noise, start.x.copy(), commands.q.copy()
    there = start.ok.copy()
    for _ in range(STEPS):
        landing = machine.run(replace(commands, q=np.where(there[:, None], q, np.nan)))
        there &= landing.ok & np.isfinite(wanted)
        x[there, 2] += (wanted - landing.tcp[:, 2])[there]
        found, ok = reach(nominal, x[there], start.R[there])
        q[there] = found
        there[np.flatnonzero(there)[~ok]] = False
    return replace(commands, q=np.where(there[:, None], q, np.nan))
