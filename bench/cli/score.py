"""Grade diagnoses of blind data sets against their sealed truths.

    pcbench score blind
    pcbench score blind --json score.json
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli.frame import JsonOption


def command(folder: Path, /, *, json: JsonOption = None) -> int:
    """Grade diagnoses of blind data sets against their sealed truths.

    Looks for NNN.diagnosis.json (of pairs of sessions NNN.changes.json) beside every NNN.csv of a folder that
    `pcbench blind` made. The exit code is 1 if a bound is missed by more than chance allows, or if a data set has no
    diagnosis.

    Args:
        folder: What `pcbench blind` wrote.
    """
    from bench.jobs import score as scores
    from bench.jobs.changes import blind as pairs
    from pcalib.cli import frame

    if pairs.holds_changes(folder):
        return _changes(folder, json)
    found = scores.score(folder)
    wrong = sum(g.mark.is_wrong for g in found.grades)
    right = sum(g.mark.is_right for g in found.grades)
    is_wrong = "1 is wrong" if wrong == 1 else f"{wrong} are wrong"
    frame.say(f"{right} of {len(found.grades)} diagnoses are right, {is_wrong}, the others undecided or missed.")
    frame.show_table(
        ("data", "design", "hidden", "s", "verdict", "established or adequate", "grade"),
        [
            (
                name,
                design,
                " + ".join(g.facts.faults) or "nothing",
                f"{g.facts.size:.1f}" if g.facts.faults else "",
                g.answer.verdict.replace("_", " "),
                " or ".join(" + ".join(names) for names in g.answer.adequate if names),
                g.mark.value,
            )
            for name, design, g in zip(found.names, found.designs, found.grades, strict=True)
        ],
    )
    show_lines(found.lines)
    if found.missing:
        frame.say(f"Without a diagnosis: {', '.join(found.missing)}.")
    frame.write_json(json, found.to_json())
    return frame.OK if found.holds else frame.NOT_HELD


def _changes(folder: Path, json: Path | None) -> int:
    """Grade what was said of pairs of sessions."""
    from bench.jobs.changes import blind as pairs
    from bench.jobs.changes.study import inside, lines
    from pcalib.cli import frame
    from pcalib.errors import InputError

    rows, missing = pairs.score(folder)
    if not rows:
        raise InputError("holds no answer about any pair of sessions", file=folder, remedy=pairs.WRITTEN_BY)
    found = [line for line in lines(rows) if line.name not in ("year", "rod")]
    frame.show_table(
        ("data", "changed", "s", "verdict", "answers", "truth among them"),
        [
            (r["name"], " + ".join(r["truth"]) or "nothing", f"{r['s']:.1f}", r["verdict"].replace("_", " "),
             " or ".join(" + ".join(names) for names in r["adequate"]), "yes" if inside(r) else "")
            for r in rows
        ],
    )  # fmt: skip
    show_lines(found)
    if missing:
        frame.say(f"Without an answer: {', '.join(missing)}.")
    holds = not missing and all(line.verdict != "falls short" for line in found)
    frame.write_json(json, {
        "schema": "pcbench.score/1", "sets": rows, "bounds": [line.to_json() for line in found], "missing": missing,
        "holds": holds,
    })  # fmt: skip
    return frame.OK if holds else frame.NOT_HELD


def show_lines(lines) -> None:
    """Rates against bounds, as a table."""
    from pcalib.cli import frame

    frame.show_table(
        ("", "bound", "figure", "of", "verdict"),
        [
            (
                line.what,
                f"{'≤' if line.at_most else '≥'} {100 * line.bound:g} %",
                f"{100 * line.rate:.1f} %" if line.n else "–",
                line.n,
                line.verdict,
            )
            for line in lines
        ],
    )
