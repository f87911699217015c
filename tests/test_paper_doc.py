"""docs/paper.md accounts for every numbered equation, and every name in it exists."""

import importlib
import re
from pathlib import Path

import pytest

TEXT = (Path(__file__).parents[1] / "docs" / "paper.md").read_text(encoding="utf-8")
TABLE = TEXT.split("## Equations and functions")[1].split("## Errata")[0]
NAMES = sorted(set(re.findall(r"`(pcalib\.[\w.]+)`", TEXT)))


def numbers(cell: str) -> set[int]:
    """Equation numbers of '(4), (5)' or '(9)–(11)'."""
    out: set[int] = set()
    for first, last in re.findall(r"\((\d+)\)(?:–\((\d+)\))?", cell):
        out |= set(range(int(first), int(last or first) + 1))
    return out


def test_every_equation_has_its_row():
    rows = [line.split("|") for line in TABLE.splitlines() if re.match(r"\| \(", line)]
    found = [n for row in rows for n in numbers(row[1])]
    assert sorted(found) == list(range(1, 75))
    for row in rows:
        assert re.search(r"`|none:", "|".join(row[3:])), row


@pytest.mark.parametrize("name", NAMES)
def test_names_exist(name):
    parts = name.split(".")
    for n in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:n]))
        except ModuleNotFoundError:
            continue
        for part in parts[n:]:
            found = getattr(found, part, None) or found.__dataclass_fields__[part]
        return
    pytest.fail(f"{name} does not exist")
