"""Small campaigns for tests."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest

SMALL = """
name = "small"
robot = "delta"
robots = 6
seed = 11
[geometry]
sigma_length_mm = 0.1
sigma_angle_deg = 0.05
[instrument]
sigma_pos_mm = 0.02
sigma_rot_deg = 0.005
[plan]
poses = 14
[verify]
targets = 8
tools_mm = [0, 300]
[output]
part_robots = 2
map_robots = 1
[[method]]
name = "model24"
[[method]]
name = "complete"
"""


class Writer:
    """Writes specs into a folder."""

    small = SMALL

    def __init__(self, folder: Path):
        self.folder = folder

    def __call__(self, text: str = SMALL, name: str = "spec.toml", /, **replaced: str) -> Path:
        """The path of a spec with this text; whole lines `key = …` may be replaced."""
        text = textwrap.dedent(text)
        for old, new in replaced.items():
            assert f"{old} = " in text, old
            text = "\n".join(new if line.startswith(f"{old} = ") else line for line in text.splitlines())
        path = self.folder / name
        path.write_text(text)
        return path


@pytest.fixture
def written(tmp_path) -> Writer:
    """Specs in a temporary folder."""
    return Writer(tmp_path)
