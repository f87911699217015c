"""Effects of the user's own with slips in them."""

from __future__ import annotations

import re

import pytest

SLIPS = {
    "raises": (r"return .*", "return 1 / 0", r":8: .*ZeroDivisionError"),
    "raises on large data": ("return", "assert len(at.q) < 20\n        return", r":8: .*AssertionError"),
    "leaves": ("return", "raise SystemExit(0)\n        return", r":8: .*raised SystemExit"),
    "leaves on loading": ("class Mine", "raise SystemExit(0)\nclass Mine", r":3: loading raised SystemExit"),
    "wrong shape": (r"np.sin\(3 \* at.q\)", "at.q[:, :2]", r":7: .*actuator has shape \(\d+, 2\), not \(\d+, 3\)"),
    "wrong type": (r"Contribution\(.*", "3.0", r":7: .*contribution returned float"),
    "NaN": (r"theta\[0\]", "np.nan", r":7: .*actuator is not finite"),
    "unit": ('"urad"', '"furlong"', r"bad\.py: Mine: parameter 'size': unknown unit 'furlong'"),
    "syntax": ("return Contribution", "return (Contribution", r":8: '\(' was never closed"),
    "import": ("import numpy", "import no_such_module\nimport numpy", r":1: loading raised ModuleNotFoundError"),
    "class": ("class Mine", "class Yours", "unknown class 'Mine'; accepted: Yours"),
    "name of the library": ('"mine"', '"backlash"', "'backlash' is an effect of the library"),
    "no parameters": (r"parameters = .*", "parameters = ()", r"bad\.py"),
    "recursion": ("return", "self.contribution(at, theta)\n        return", r":8: .*RecursionError"),
}  # fmt: skip


@pytest.mark.parametrize("slip", SLIPS)
def test_effects_of_the_users_own(slip, cell, each_refused):
    old, new, said = SLIPS[slip]
    text, count = re.subn(old, new, (cell / "mine.py").read_text(), count=1)
    assert count == 1
    (cell / "bad.py").write_text(text)
    each_refused("effect", "bad.py", said, but="effect check" if "large" in slip else "$^")


def test_an_effect_without_its_column(cell, each_refused):
    text = (cell / "mine.py").read_text().replace("needs = ()", 'needs = ("humidity",)')
    (cell / "bad.py").write_text(text.replace("at.q)", 'at.q) * at.column("humidity")[:, None]'))
    each_refused("effect", "bad.py", "humidity", "", but="diagnose|effect check")
