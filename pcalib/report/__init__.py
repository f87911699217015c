"""Reports: one self-contained HTML file, from sections that any command can make.

    page = Page("Calibration of delta", "With a 300 mm tool …", sections=(ladder_section(ladder), …))
    report.write("report.html", page)

A section is a heading and blocks (text, lists, tables, figures); how they look is the template's business alone.
Nothing in the file comes from elsewhere: styles and figures (SVG) are inside, and there are no scripts.
"""

from __future__ import annotations

from pcalib.report.page import (
    Block as Block,
)
from pcalib.report.page import (
    Bullets as Bullets,
)
from pcalib.report.page import (
    Facts as Facts,
)
from pcalib.report.page import (
    Figure as Figure,
)
from pcalib.report.page import (
    Page as Page,
)
from pcalib.report.page import (
    Section as Section,
)
from pcalib.report.page import (
    Table as Table,
)
from pcalib.report.page import (
    Text as Text,
)
from pcalib.report.page import (
    html as html,
)
from pcalib.report.page import (
    write as write,
)
