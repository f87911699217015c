"""How far off a commanded TCP may be: from what a fit knows, from what it leaves unexplained, and from its rivals.

    radius.py       the sphere that contains a share of a normal deviate
    propagation.py  covariance of the TCP at commands, by component, and the radius u95
    discrepancy.py  what a fit leaves unexplained, from rows that it was not fitted to
    outlook.py      what to expect over the workspace, in one sentence and as JSON
    acceptance.py   pass, fail or cannot tell, with a guard band (ISO 14253-1)
    poses.py        how many poses reach an accuracy
"""

from __future__ import annotations

from pcalib.uncertainty.discrepancy import assessed as assessed
from pcalib.uncertainty.propagation import Expected as Expected
from pcalib.uncertainty.propagation import expect as expect
