"""Reports: self-contained, everything escaped, and saying what the fit says."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from pcalib import report
from pcalib.errors import InputError
from pcalib.fitting import identifiability, identification
from pcalib.fitting.identification import Fit
from pcalib.ladder import ErrorMap, Ladder, Step
from pcalib.model import Model
from pcalib.report import figures, sections
from pcalib.report.page import Bullets, Figure, NamedValues, Page, Section, Table, Text, versions

HOSTILE = '</title><script>alert("x")</script><img src=x onerror=alert(1)> & \'"$x^2$'


class Elements(HTMLParser):
    """Tags with their attributes, text, and whether tags are balanced."""

    EMPTY: ClassVar = {"meta", "img", "br", "link", "path", "use", "rect", "circle", "line", "polyline", "image"}

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words, self.open = "", []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if tag not in self.EMPTY:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data


@pytest.fixture(scope="module")
def fit(delta, perturb, measure) -> Fit:
    check = np.arange(50) >= 40
    return identification.fit(measure(Model(delta, perturb(4)), 50, check=check), delta)


@pytest.fixture(scope="module")
def ladder(delta, fit) -> Ladder:
    rng = np.random.default_rng(1)
    z, y, x = np.meshgrid([-0.9, -0.7], np.linspace(-0.2, 0.2, 4), np.linspace(-0.2, 0.2, 4), indexing="ij")
    targets = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    nominal = Step("nominal", "Nominal", Model.nominal(delta), "none", "As drawn.")
    steps = (nominal, Step("c", "Complete", fit.model, fit=fit))
    errors = np.array([1e-3, 2e-5])[:, None, None] * rng.standard_normal((2, len(targets), 3))
    status = np.full(errors.shape[:2], "ok", "<U20")
    errors[1, 3], status[1, 3] = np.nan, "unreachable"
    maps = tuple(ErrorMap(np.array([0, 0, -h]), targets - [0, 0, h], (1 + h) * errors, status) for h in (0.0, 0.3))
    return Ladder(delta, steps, maps, "measured", 2e-5)


@pytest.fixture(scope="module")
def full(ladder, fit) -> str:
    parts = [
        sections.ladder(ladder), sections.error_maps(ladder), sections.data(fit, "A source."),
        sections.parameters(fit, fit.candidate.k), sections.unidentifiable(fit),
    ]  # fmt: skip
    return report.html(Page("Title", "A verdict.", parts, "good", versions()))


def test_nothing_comes_from_elsewhere(full):
    assert not re.search(r"(?:https?:)?//[a-z]", full), "no address of any kind"
    found = Elements(full)
    assert not {"script", "link", "iframe", "object", "embed", "img", "base", "form"} & {tag for tag, _ in found.tags}
    for tag, attributes in found.tags:
        assert not {"src", "href", "srcset", "action"} & set(attributes), tag
        assert (attributes.get("xlink:href") or "#").startswith(("#", "data:image/png;base64,"))
        assert not [a for a in attributes if a.startswith("on")]
    assert not re.search(r"url\((?!#)", full) and "@import" not in full
    assert "default-src 'none'" in full


def test_markup_is_well_formed_and_the_verdict_comes_first(full):
    found = Elements(full)
    assert found.open == []
    headings = [tag for tag, _ in found.tags if tag in ("h1", "h2")]
    assert headings[0] == "h1" and headings.count("h1") == 1
    body = found.words[found.words.index("Title", found.words.index("}")) :]
    assert body.index("A verdict.") < body.index("How the error falls")


def test_it_says_what_the_ladder_and_the_fit_say(full, ladder, fit):
    text = Elements(full).words
    for word in ("1 of 32 targets are left out", "What the data cannot tell", "held out", "true change"):
        assert word in text
    from pcalib.wording import size

    for value in [*ladder.rms.ravel(), *ladder.max.ravel(), fit.accuracy.rms_pos, fit.check.rms_pos]:
        assert size(value) in text
    assert all(name in text for name in fit.candidate.robot.mechanism.parameters)


def test_it_names_every_parameter_that_cannot_be_told_and_from_what(full, fit):
    cannot = full[full.index("What the data cannot tell") :]
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row, re.S) for row in re.findall(r"<tr[^>]*>(.*?)</tr>", cannot, re.S)]
    rows = [[Elements(cell).words for cell in row] for row in rows if row]
    dependent = fit.identifiability.dependent
    assert [row[0] for row in rows] == list(dependent) and len(rows) == 18
    for (name, said), mix in zip(rows, dependent.values(), strict=True):
        main, rest = fit.identifiability.companions()[name]
        assert set(re.findall(r"[a-z]+\d+(?:\.[xyz])?", said)) == set(main), said
        assert len(main) + rest == len(mix) and (f"and {rest} lesser terms" in said) == (rest > 0)
        for other, factor in main.items():
            sign, shown = re.search(rf"([−+]?) ?([\d.e-]*)·?{re.escape(other)}", said).groups()
            assert float(shown or 1) * (-1 if sign == "−" else 1) == pytest.approx(factor, rel=0.06), (name, said)


def test_a_parameter_without_a_trace_is_said_to_have_none(delta, measure, perturb):
    bare = identifiability.Identifiability(("a", "b"), np.zeros(2), np.zeros((2, 2)), np.arange(2), np.ones(2))
    assert bare.companions() == {"a": ({}, 0), "b": ({}, 0)}
    found = identification.fit(measure(Model(delta, perturb(4)), 50), delta)
    text = Elements(report.html(Page("T", "V", [sections.unidentifiable(replace(found, identifiability=bare))]))).words
    assert text.count("it leaves no trace") == 2


def test_everything_is_escaped():
    h = HOSTILE
    page = Page(h, h, [Section(h, [
        Text(h, h), Bullets([h], h), NamedValues({h: h}), Table([h], [[h]], ">", h, h, (0,)), Table([h], [[h]]),
    ])], h, {h: h})  # fmt: skip
    text = report.html(page)
    found = Elements(text)
    assert not {"script", "img"} & {tag for tag, _ in found.tags} and found.open == []
    assert found.words.count("<script>") >= 12  # all there, as text
    assert all(len(attributes) <= 2 for tag, attributes in found.tags if tag in ("p", "ul", "h1", "td", "th"))


def test_names_in_figures_are_escaped_too(ladder):
    steps = tuple(replace(s, label=HOSTILE) for s in ladder.steps)
    bad = replace(ladder, steps=steps)
    for svg in (figures.ladder(bad), figures.maps(bad, 0, [0, 1])):
        found = Elements(svg)
        assert {tag for tag, _ in found.tags} <= {"svg", "g", "defs", "style", "path", "use", "text", "clippath",
            "rect", "tspan", "image", "lineargradient", "stop", "polygon"}  # fmt: skip
        assert found.open == [] and "<script>" in found.words


def test_figures_take_the_colours_of_the_page(ladder):
    svg = figures.ladder(ladder)
    assert "var(--ink)" in svg and "var(--rule)" in svg
    for stand_in in (figures.INK, figures.QUIET, figures.RULE, figures.PAPER):
        assert stand_in not in svg
    assert svg.startswith("<svg") and "width=" not in svg.split(">")[0]
    assert figures.ladder(ladder) == svg, "the same figures give the same file"


def test_a_figure_in_two_places_shares_no_names(ladder):
    """Names of clip paths are the only ones left, and equal names mean equal shapes."""
    shapes: dict[str, str] = {}
    for svg in (figures.ladder(ladder), figures.maps(ladder, 0, [0]), figures.maps(ladder, 1, [0, 1])):
        for name, shape in re.findall(r'<clipPath id="([^"]+)">(.*?)</clipPath>', svg, re.S):
            assert shapes.setdefault(name, shape) == shape


def test_values_of_the_parameter_table(fit):
    table = next(b for b in sections.parameters(fit).blocks if isinstance(b, Table) and b.folded)
    assert len(table.rows) == 60
    i = fit.candidate.robot.mechanism.index("l11")
    row = next(r for r in table.rows if r[0] == "l11")
    assert row[1] == "800.000 mm" and row[2] == f"{fit.candidate.k[i] * 1e3:.3f} mm"
    sigma = fit.candidate.sigma
    assert sigma is not None and row[4] == f"{sigma[i] * 1e3:.3f}"


@pytest.mark.parametrize(
    ("change", "sigma", "flag"),
    [(1.0, 0.1, "off by more than 3σ"), (0.2, 0.1, ""), (1.0, 0.8, "by tolerance"), (0.0, np.nan, "held")],
)
def test_flags(change, sigma, flag):
    assert sections._flag(change, sigma, 1.0) == flag


def test_warnings_are_shown_where_there_are_some(fit):
    assert sections.warnings([("a", replace(fit, warnings=()))]) is None
    section = sections.warnings([("a", replace(fit, warnings=("look",))), ("b", fit)])
    assert section is not None and "a: look" in section.blocks[0].items  # type: ignore[union-attr]


def test_writing_is_whole_or_not_at_all(tmp_path: Path):
    page = Page("t", "v", [Section("s", [Figure("<svg></svg>", "c", "d")])])
    report.write(tmp_path / "r.html", page)
    assert (tmp_path / "r.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    with pytest.raises(InputError, match="cannot write"):
        report.write(tmp_path / "absent" / "r.html", page)
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]
