"""Grade diagnoses of blind data sets against their sealed truths.

    pcbench score blind
    pcbench score blind --json score.json
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli.frame import JsonOption


def command(folder: Path, /, *, json: JsonOption = None) -> int:
    """Grade diagnoses of blind data sets against their sealed truths.

    Looks for NNN.diagnosis.json beside every NNN.csv of a folder that `pcbench blind` made. Exit code 1 where a bound
    is missed by more than chance allows, or a data set has no diagnosis.

    Args:
        folder: What `pcbench blind` wrote.
    """
    from bench.jobs import score as scores
    from pcalib.cli import frame

    found = scores.score(folder)
    wrong = sum(g.words in ("wrong", "false alarm", "taken for a known effect") for g in found.grades)
    right = sum(g.words.startswith("right") for g in found.grades)
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
                g.words,
            )
            for name, design, g in zip(found.names, found.designs, found.grades, strict=True)
        ],
    )
    show_lines(found.lines)
    if found.missing:
        frame.say(f"Without a diagnosis: {', '.join(found.missing)}.")
    frame.write_json(json, found.to_json())
    return frame.OK if found.holds else frame.NOT_HELD


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
