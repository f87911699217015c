"""The docs name every schema that the code writes; docs/files.md names the keys of what is written."""

import re
from pathlib import Path

import pytest

from pcalib import modelfile, summary
from pcalib.fitting import identification
from pcalib.model import Model

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
SCHEMAS = {
    schema
    for folder in ("pcalib", "bench")
    for file in (ROOT / folder).rglob("*.py")
    for schema in re.findall(r'"(pc(?:alib|bench)\.\w+/\d+)"', file.read_text(encoding="utf-8"))
}


def keys(value) -> set[str]:
    """Keys of nested tables that are not names of parameters, effects or other data."""
    if isinstance(value, dict):
        named = [k for k in value if k not in ("parameters", "combinations")]
        below = [value[k] for k in named] + [v for k in value if k not in named for v in value[k].values()]
        return set(value).union(*map(keys, below))
    return set().union(*map(keys, value)) if isinstance(value, list) else set()


@pytest.mark.parametrize("schema", sorted(SCHEMAS))
def test_every_schema_is_there(schema):
    said = any(f"`{schema}`" in file.read_text(encoding="utf-8") for file in (ROOT / "docs").glob("*.md"))
    assert said, f"no page of docs/ names `{schema}`: say there, e.g. in docs/files.md, what its keys mean"


@pytest.fixture(scope="module")
def fit(delta, perturb, measure):
    found = identification.fit(measure(Model(delta, perturb(1), "complete"), 40), Model.nominal(delta), "complete")
    assert found.status == "converged"
    return found


def test_the_keys_of_a_fit_are_there(fit):
    content = summary.fit_json(fit)
    assert {"l11", "bp11.x"} <= content["parameters"].keys() | content["combinations"].keys()
    assert not [key for key in keys(content) if f"`{key}`" not in TEXT]


def test_the_sections_of_a_model_file_are_there(fit):
    section = TEXT.split("## Model files")[1].split("## JSON")[0]
    text = modelfile.dumps(fit.model, summary.statistics(fit))
    for table in set(re.findall(r"^\[+(\w+)", text, re.MULTILINE)):
        assert f"[{table}" in section, table
