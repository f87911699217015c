"""Reports: one self-contained HTML file, from sections that any command can make.

    page = Page("Calibration of delta", "With a 300 mm tool …", sections=(ladder_section(ladder), …))
    report.write("report.html", page)

A section is a heading and blocks (text, lists, tables, figures); how they look is the template's business alone.
Nothing in the file comes from elsewhere: styles and figures (SVG) are inside, and there are no scripts.
"""

from __future__ import annotations

from pcalib.report.page import Bullets, Figure, NamedValues, Page, Section, SectionBlock, Table, Text, html, write

__all__ = ["Bullets", "Figure", "NamedValues", "Page", "Section", "SectionBlock", "Table", "Text", "html", "write"]
