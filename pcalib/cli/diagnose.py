"""Which physical effect is missing from a model, as far as the data can tell.

pcalib diagnose data.csv --model m.toml
pcalib diagnose data.csv --model m.toml --most 3 --json diagnosis.json
pcalib diagnose data.csv --model m.toml --effect worm_gear.py:WormGear
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pcalib.cli._inputs import EffectFiles, ModelOption
from pcalib.cli._next import say_next, to_compensate
from pcalib.cli.frame import BesideOption, JsonOption, SeedOption, say, show_table, write_json

if TYPE_CHECKING:
    from pcalib.diagnosis.diagnose import Diagnosis
    from pcalib.laws.verdict import Beside


def command(
    data: Path,
    /,
    *,
    model: ModelOption,
    most: int = 2,
    plausible: tuple[str, ...] = (),
    effect_file: EffectFiles = (),
    report: BesideOption = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> int | None:
    """Which physical effect is missing from a model, as far as the data can tell.

    One of four verdicts. Nothing is missing: with the smallest effects that would have been seen. Established: one
    explanation is left. Ambiguous: A or B, and these poses cannot tell which. Unexplained: something is missing that no
    effect of the library (or of yours) makes good, with where it shows.

    Args:
        data: Measurement file, CSV or Parquet.
        most: Most effects in one explanation.
        plausible: NAME=FACTOR widens what sizes of an effect count as plausible, for a robot that is known to be odd.
        report: Also write a report, one self-contained HTML file.
        seed: Seed of the Monte-Carlo draws that set the limits of significance.
    """
    from pcalib.cli._inputs import read
    from pcalib.diagnosis import advice, results
    from pcalib.diagnosis.diagnose import diagnose
    from pcalib.errors import InputError
    from pcalib.laws import telling as laws_in_words
    from pcalib.laws.verdict import beside
    from pcalib.uncertainty import outlook, rivals

    if not 1 <= most <= 3:
        raise InputError(f"--most {most} effects in one explanation are not searched", remedy="choose 1, 2 or 3")
    calibrated, measured, own = read(model, data, effect_file)
    found = diagnose(calibrated, measured, own, largest=most, seed=seed, widened=_widened(plausible))
    laws = beside(found, seed)
    found = laws.found if laws is not None else found
    proposed = laws_in_words.as_json(laws.proposals, None)["laws"] if laws is not None else []
    expected, uncertainty = outlook.said(calibrated, rivals.models(calibrated, effect_file))
    write_json(json, {**results.diagnosis_json(found), "laws": proposed, "uncertainty": uncertainty})
    if report is not None:  # before anything is printed: a closed pipe loses no file
        from pcalib.diagnosis import page

        first = [laws_in_words.section(laws.proposals)] if laws is not None and laws.sentence else []
        page.write_diagnosis(report, calibrated, found, str(model), first)
    show(found, laws)
    say(f"Of the model as it is: {expected}")
    if report is not None:
        say(f"Report written to {report}.")
    files = [word for path in effect_file for word in ("--effect-file", str(path))]
    lawful = False
    if laws is not None and (laws.better or found.verdict == "unexplained"):
        lawful = bool(laws.proposals.families)
    if lawful:
        say_next("propose", data, "--model", model, "-o", "laws", *files)
    steps = advice.advised(found, str(model))
    if found.verdict == "nothing_missing" and not any(step.words for step in steps):
        to_compensate(model)
    for step in steps:
        if lawful and step.words[:1] == ("effect",):
            continue
        if step.words:
            say_next(*step.words, *files, why=step.why)
        else:
            say(f"- {step.why}")
    return None


def _widened(plausible: tuple[str, ...]) -> dict[str, float]:
    """Effect → factor, from NAME=FACTOR.

    Raises:
        InputError: no known effect, or no factor above 0.
    """
    from pcalib import effects
    from pcalib.errors import InputError, unknown

    out = {}
    for text in plausible:
        name, _, factor = text.partition("=")
        if name not in effects.names():
            raise InputError(unknown("effect of the library", name, effects.names()), remedy="write NAME=FACTOR")
        try:
            out[name] = float(factor)
        except ValueError:
            out[name] = 0.0
        if not 0 < out[name] < 1e6:
            raise InputError(f"--plausible {text}: '{factor}' is no factor", remedy=f"write e.g. {name}=3")
    return out


def show(found: Diagnosis, laws: Beside | None = None) -> None:
    """Print a diagnosis: the verdict, a law where no effect explains the data, and the details of both."""
    from pcalib.diagnosis import telling

    say(telling.sentence(found))
    if laws is not None and found.verdict == "unexplained" and laws.sentence:
        say(laws.sentence)
    print()
    for law in laws.rivals if laws is not None else ():
        much = "better" if laws is not None and laws.better else "as well"
        say(f"- A law outside the library fits {much}: {law}. 'pcalib propose' writes it; measure what differs.")
    for line in telling.details(found):
        say(f"- {line}")
    print()
    if found.verdict in ("ambiguous", "established") and len(found.sets) > 1:
        show_table(
            ("explanation", "in words"),
            [(" + ".join(e.names), e.words()) for e in found.sets[:8]],
            title="Explanations that these data cannot rule out, the best by BIC first",
        )
    show_table(telling.CANDIDATES, telling.candidate_rows(found), title="Candidates")
    if left := telling.candidates_left(found):
        say(left)
        print()
    if hot := telling.hot_cells(found.cells):
        show_table(
            ("where", "by", "s", "p"),
            [(telling.channel(c), telling.variable(c), f"{c.s:.1f}", telling.p_text(c.p)) for c in hot[:6]],
            title="Where it shows",
        )
    if found.verdict == "nothing_missing":
        show_table(
            ("effect", "would have been seen from"), telling.limit_rows(found), title="What would have been seen"
        )
    for unavailable in found.unavailable:
        say(f"- {unavailable.name}: not considered, {unavailable.why}.")
