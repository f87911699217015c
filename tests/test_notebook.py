"""Results in notebooks, and the notebook of the docs, whose cells run here."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import pcalib
from bench.jobs import notebook
from pcalib.data.measurement import Measurements

ROOT = Path(__file__).resolve().parents[1]
STORY = json.loads((ROOT / "docs" / "notebooks" / "story.ipynb").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The names that the story's cells define, and what they show."""
    folder = tmp_path_factory.mktemp("notebook")
    (folder / "models").symlink_to(ROOT / "models")
    names: dict = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        shown = [outputs for _, outputs in notebook.run(STORY, names)]
    return names, shown


def text(outputs, kind):
    return ["".join(output["data"][kind]) for output in outputs if kind in output.get("data", {})]


def test_the_story_ends_with_the_right_effect(ran):
    names, _ = ran
    assert names["diagnosis"].verdict == "ambiguous"
    assert ("drive_compliance",) in {explanation.names for explanation in names["diagnosis"].sets}
    assert names["step"].fell and (names["commands"].status == "ok").all()
    assert names["fit"].check.rms_pos > 1.4 * names["step"].after.check.rms_pos


def test_the_kept_outputs_are_those_of_the_cells(ran):
    """Sentences and printed figures; drawings and long tables may differ in their last digits."""
    kept = [cell["outputs"] for cell in STORY["cells"] if cell["cell_type"] == "code"]
    for was, now in zip(kept, ran[1], strict=True):
        assert [o.get("text") for o in was] == [o.get("text") for o in now]
        assert text(was, "text/plain") == text(now, "text/plain")
        for a, b in zip(text(was, "text/html"), text(now, "text/html"), strict=True):
            assert a.split("</b>")[0] == b.split("</b>")[0] and re.findall("<h4>.*", a) == re.findall("<h4>.*", b)


def test_every_name_is_escaped(delta):
    data = Measurements.create(
        delta, np.zeros((2, 3)), np.array([[0, 0, -0.8], [0, 0, -0.8]]), columns={"<b>x</b>": np.ones(2)},
        source="<script>alert(1)</script>.csv",
    )  # fmt: skip
    shown = data._repr_html_()
    assert "<script>" not in shown and "<b>x</b>" not in shown
    assert "&lt;script&gt;" in shown and "&lt;b&gt;x&lt;/b&gt;" in shown


def test_tables_become_frames(delta):
    made = pcalib.compensate(pcalib.Model.nominal(delta), [[0, 0, -0.8], [9, 9, 9]])
    arrow = made.to_arrow()
    assert arrow.column_names == ["q1_si", "q2_si", "q3_si", "status"] and arrow["status"].to_pylist()[0] == "ok"
    assert "Commands for 1 of 2 targets" in made._repr_html_()
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    assert isinstance(made.to_pandas(), pandas.DataFrame)
