"""Grade the diagnoses of a blind test (`pcalib.diagnosis/1`, docs/files.md) against the sealed truths."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.jobs import blind
from bench.jobs.hidden.grading import WRITTEN_BY, Answer, Grade, Line, lines
from pcalib import files
from pcalib.errors import InputError

SEALED_BY = "sealed truths are written by 'pcbench blind', and not meant to be changed"


@dataclass(frozen=True)
class Score:
    """All grades of a folder."""

    names: tuple[str, ...]
    grades: tuple[Grade, ...]
    designs: tuple[str, ...]
    missing: tuple[str, ...]
    """Data sets without a diagnosis."""

    @property
    def lines(self) -> list[Line]:
        """Rates against bounds."""
        return lines(self.grades)

    @property
    def holds(self) -> bool:
        """Whether no bound is broken by more than chance, and every data set was diagnosed."""
        return not self.missing and all(line.verdict != "falls short" for line in self.lines)

    def to_json(self) -> dict[str, Any]:
        """`pcbench.score/1`."""
        return {
            "schema": "pcbench.score/1",
            "sets": [
                {"data": f"{name}.csv", "design": design}
                | g.to_json()
                | {"truth": list(g.facts.effects or g.facts.faults)}
                for name, design, g in zip(self.names, self.designs, self.grades, strict=True)
            ],
            "grades": dict(Counter(g.mark.value for g in self.grades)),
            "bounds": [line.to_json() for line in self.lines],
            "missing": list(self.missing),
            "holds": self.holds,
        }


def score(folder: Path) -> Score:
    """Grade the diagnoses NNN.diagnosis.json of a folder that `pcbench blind` made.

    Raises:
        InputError: no sealed truths, no diagnosis at all, or one that is no diagnosis.
    """
    sealed = sorted((folder / blind.SEALED).glob("*.json"))
    if not sealed:
        raise InputError("holds no sealed truths", file=folder, remedy="name a folder that 'pcbench blind' made")
    names, grades, designs, missing = [], [], [], []
    for path in sealed:
        truth = files.parse_json(files.read_text(path), path, SEALED_BY)
        if truth.get("schema") != blind.SCHEMA:
            raise InputError(f"schema is {truth.get('schema')!r}, not '{blind.SCHEMA}'", file=path, remedy=SEALED_BY)
        answer = folder / f"{path.stem}.diagnosis.json"
        if not answer.exists():
            missing.append(path.stem)
            continue
        files.require_shape(truth, blind.SHAPE, path, SEALED_BY)
        facts = blind.facts_of(truth)
        said = files.parse_json(files.read_text(answer), answer, WRITTEN_BY)
        names.append(path.stem)
        designs.append(str(truth.get("design", "")))
        grades.append(Grade(facts, Answer.of_json(said, answer)))
    if not grades:
        raise InputError(
            "holds no diagnosis of any data set", file=folder,
            remedy="write them with pcalib diagnose 001.csv --model 001.toml --json 001.diagnosis.json, and so on",
        )  # fmt: skip
    return Score(tuple(names), tuple(grades), tuple(designs), tuple(missing))
