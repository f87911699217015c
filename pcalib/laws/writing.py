"""A law as an effect file: ten lines of Python that a user reads, changes and names on the command line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pcalib import units
from pcalib.laws.channels import ARM
from pcalib.laws.grammar import EACH, Law, by_arm
from pcalib.wording import capital, figure

_HELPERS = ("along_arms", "motor_axes")
"""Functions of `pcalib.laws.channels` that a channel's text may use."""


def names(law: Law) -> tuple[str, str]:
    """The effect's name in snake case and the name of its class, e.g. actuator_by_torque and ActuatorByTorque."""
    where = law.channel.name if law.sharing in law.places or not law.channel.vector else law.channel.words.split()[-1]
    words = [where, *([law.sharing] if law.sharing in law.places else []), "by"]
    words += [] if law.term.times is not None or law.term.shape.name == "linear" else [law.term.shape.name]
    words += [s.variable.words if s.variable.words.count(" ") > 1 else s.variable.name for s in law.term.variables]
    snake = re.sub(r"[^a-z0-9]+", "_", " ".join(words).lower().replace("its own ", "").replace("'s", "")).strip("_")
    return snake, "".join(word.capitalize() for word in snake.split("_"))


def equation(law: Law) -> str:
    """The law in one line of Python, amplitudes as A."""
    functions = [f"A·{text}" for text in law.term.text(vector=True)]
    each = ["with an amplitude for each place"] if law.sharing == EACH else []
    return "\n        ".join([" +\n        ".join(functions), *each])


def written(law: Law, theta: np.ndarray, source: str) -> str:
    """The text of an effect file for a law with amplitudes theta (columns,) [SI], found in the data of `source`."""
    snake, camel = names(law)
    shown = units.factor(law.channel.unit)
    body, size = _body(law)
    prior = float(f"{max(float(np.abs(theta).max()), 1e-9):.2g}")
    values = ", ".join(figure(float(v) / shown) for v in theta)
    parameters = "".join(
        f'\n        EffectParameter("{name}", "{law.channel.unit}", {prior:g}),' for name in law.amplitudes
    )
    expression = law.channel.text.format(v=size)
    used = [name for name in _HELPERS if f"{name}(" in expression]
    helpers = f"from pcalib.laws.channels import {', '.join(used)}\n" if used else ""
    numpy = "import numpy as np\n\n" if "np." in "".join((*body, expression)) else ""
    text = f'''"""{capital(law.words())}.

`pcalib propose` wrote this law for {_quoted(source)}.
Amplitudes fitted there: {values} {units.spoken(law.channel.unit)}.
"""

{numpy}from pcalib.effects import Contribution, Effect, EffectParameter
{helpers}

class {camel}(Effect):
    """Deviation of {law.channel.words}:

        {_quoted(equation(law))}
    """

    name = "{snake}"
    title = "{law.words()}"
    parameters = ({parameters}
    )
    needs = ({"".join(f'"{name}", ' for name in law.needs).rstrip()})

    def contribution(self, at, theta):
        """Nothing at theta = 0; the amplitudes have the unit of the channel, the function has none."""
{"".join(f"        {line}{chr(10)}" for line in body)}        return {expression}
'''
    return text.replace('", )', '",)')


def _body(law: Law) -> tuple[list[str], str]:
    """Lines that compute the deviation, and the name under which the channel finds it."""
    vector, n = law.channel.vector, len(law.places)
    functions = law.term.text(vector)
    lines, parts = [], []
    for i, text in enumerate(functions):
        name = ("shape",) if len(functions) == 1 else ("sine", "cosine")
        spread = f"({text})[:, {ARM}]" if by_arm(law.term, law.channel) else text
        lines.append(f"{name[i]} = {spread}")
        parts.append(_sized(law, name[i], i, n))
    lines.append(f"size = {' + '.join(parts)}")
    if not vector and law.term.per == "pose" and law.sharing == "common":  # one column for all places
        lines.append(f"size = size * np.ones({n})")
    return lines, "size"


def _sized(law: Law, name: str, i: int, n: int) -> str:
    """Amplitudes times one function, (N, places)."""
    if law.sharing == EACH:
        mine = "theta" if len(law.term.shape.text) == 1 else f"theta[{i * n}:{(i + 1) * n}]"
        return f"np.outer({name}, {mine})" if law.channel.vector else f"{mine} * {name}"
    if law.sharing in law.places:
        one = [int(place == law.sharing) for place in law.places]
        return f"theta[{i}] * " + (f"np.outer({name}, {one})" if law.channel.vector else f"{name} * np.array({one})")
    return f"theta[{i}] * {name}"


def _quoted(text: str) -> str:
    """Text that may stand in a docstring."""
    return text.replace("\\", "/").replace('"', "'")


def spec(law: Law, folder: str | Path) -> str:
    """How a command line names the file of a law in a folder."""
    snake, camel = names(law)
    return f"{Path(folder) / f'{snake}.py'}:{camel}"
