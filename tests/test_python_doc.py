"""docs/python.md runs as it stands, and its results are those it states."""

import re
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The names that all blocks together define."""
    folder = tmp_path_factory.mktemp("python")
    (folder / "models").symlink_to(ROOT / "models")
    space: dict = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        (shell,) = re.findall(r"```sh\npcbench (.*?)\n```", TEXT)
        assert main(shell.split()) == 0
        exec("\n".join(re.findall(r"```python\n(.*?)```", TEXT, re.S)), space)
    return space


def test_the_loop_ends_with_the_right_effect(ran):
    assert ran["diagnosis"].verdict == "ambiguous"
    assert {("drive_compliance",), ("arm_bending",)} == {explanation.names for explanation in ran["diagnosis"].sets}
    assert ran["rows"].q.shape == (6, 3) and "Treat the two as one" in ran["rows"].sentence()
    assert ran["step"].fell and ran["again"].verdict == "nothing_missing"
    assert min(ran["comparison"].times_noise) > 1.2 and ran["fit"].status == "converged"


def test_commands_are_the_exact_inverse(ran):
    assert (ran["commands"].status == "ok").all()
    assert np.abs(ran["there"].position - ran["targets"]).max() < 1e-9
    assert [fitted.effect.name for fitted in ran["model"].effects] == ["drive_compliance"]


def test_an_effect_of_ones_own_is_ranked(ran):
    assert "encoder_warming" in [finding.candidate.name for finding in ran["found"].findings]
