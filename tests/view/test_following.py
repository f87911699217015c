"""A viewer that follows a model file, with a window that keeps what it is given."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pcalib import modelfile
from pcalib.errors import InputError
from pcalib.model import Model
from pcalib.view import following
from pcalib.view.model import predicted


class Kept:
    """A window: after each recording the next edit is made, and after the last one it is closed."""

    def __init__(self, *edits) -> None:
        self.edits, self.taken, self.closed = list(edits), [], False

    def open(self) -> bool:
        return not self.closed

    def take(self, recording: Path) -> None:
        self.taken.append(recording.read_bytes())
        if not self.edits:
            self.closed = True
            return
        self.edits.pop(0)()

    def close(self) -> None:
        self.closed = True


def test_every_step_of_a_model_appears(delta, perturb, tmp_path):
    path, later = tmp_path / "m.toml", tmp_path / "later.toml"
    modelfile.save(path, Model(delta, perturb(1), "complete"))
    step = modelfile.snapshot(Model(delta, perturb(2), "complete"), "add", effect="backlash")
    modelfile.save(later, Model(delta, perturb(2), "complete", history=(step,)))
    window = Kept(lambda: shutil.copy(later, path))
    drawn = []

    def draw(model):
        drawn.append(len(model.history))
        return predicted(model)

    following.follow(path, window, draw)
    assert drawn == [0, 1] and b"step 1" in window.taken[1] and window.taken[0] != window.taken[1]


def test_a_file_that_is_no_model_closes_the_window(delta, perturb, tmp_path):
    path = tmp_path / "m.toml"
    modelfile.save(path, Model(delta, perturb(1), "complete"))
    window = Kept(lambda: path.write_text("nothing = 1"))
    with pytest.raises(InputError, match="not a model file"):
        following.follow(path, window, predicted)
    assert window.closed
