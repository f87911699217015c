"""What a report is made of, and its way into a file. All text is plain and escaped; only figures hold markup."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: str
    tone: str = ""
    """'' or 'quiet'."""


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    kind: ClassVar[str] = "bullets"
    items: Sequence[str]
    tone: str = ""
    """'' or 'warning'."""


@dataclass(frozen=True)
class NamedValues:
    """Names and values, such as where things come from."""

    kind: ClassVar[str] = "facts"
    pairs: Mapping[str, str]


@dataclass(frozen=True)
class Table:
    """Rows under a header; a column is set to the right where its alignment is '>'."""

    kind: ClassVar[str] = "table"
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    align: str = ""
    """One of '<' and '>' per column; left where absent."""
    note: str = ""
    folded: str = ""
    """A title under which the table is folded away; not folded where empty."""
    marked: Sequence[int] = ()
    """Rows that stand out."""

    def side(self, column: int) -> str:
        """'right' or 'left'."""
        return "right" if self.align[column : column + 1] == ">" else "left"


@dataclass(frozen=True)
class Figure:
    """A drawing made by :mod:`pcalib.report.figures`."""

    kind: ClassVar[str] = "figure"
    svg: str
    caption: str
    describes: str
    """What is seen, for those who cannot see it."""


SectionBlock = Text | Bullets | NamedValues | Table | Figure


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: Sequence[SectionBlock]


@dataclass(frozen=True)
class Page:
    """A report: the verdict first, then the reasons."""

    title: str
    verdict: str
    """One plain sentence."""
    sections: Sequence[Section]
    tone: str = "neutral"
    """'good', 'bad' or 'neutral': colour of the verdict's edge."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Versions, seeds, files: what is needed to get the same again."""


def html(page: Page, template: str = "page") -> str:
    """The report as the text of an HTML file.

    Args:
        template: 'page', or 'notebook' for what stands among others in a notebook.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("pcalib.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["drawing"] = Markup
    return environment.get_template(f"{template}.html.j2").render(page=page)


def write(path: str | Path, page: Page) -> None:
    """Write a report, atomically."""
    from pcalib import files

    files.write_text(path, html(page))


def versions() -> dict[str, str]:
    """Versions of pcalib, NumPy, SciPy and Python, and the machine, for a page's provenance."""
    import platform
    from importlib import metadata

    names = ("pcalib", "numpy", "scipy")
    found = {}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed as a package"
    return found | {"python": platform.python_version(), "machine": f"{platform.system()} {platform.machine()}"}
