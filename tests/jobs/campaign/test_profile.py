"""Where a campaign's time goes: the clocks add up, and are taken off again."""

from __future__ import annotations

import re

import numpy as np

from bench.jobs.attack import kills
from bench.jobs.campaign import profile


def test_the_command_shows_times_and_memory(capsys):
    solve = np.linalg.solve
    assert profile.main(["--quick"]) == 0
    assert np.linalg.solve is solve
    out = capsys.readouterr().out
    assert out.startswith("10 robots of thousand on one core: ") and "MiB after 10" in out
    shares = re.findall(r"^ *(?:inside MuJoCo|inside LAPACK|array arithmetic and Python) .* (\d+) %", out, re.MULTILINE)
    assert len(shares) == 3 and 98 <= sum(map(int, shares)) <= 102
    assert profile.main(["--robots", "0"]) == 2


def test_no_program_has_a_version_of_its_own(capsys):
    for program in (profile, kills):
        assert program.main(["--version"]) == 2
        assert "--version" in capsys.readouterr().err
