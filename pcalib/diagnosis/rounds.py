"""How much chance is spent on each round of measuring and diagnosing again.

Who measures more rows and asks again looks again, and ten looks at 5 % are not 5 %: with pure noise, rows that grow
from 120 to 390 in ten rounds raise 17 % alarms if each round may raise 4 %. So round k spends the first one's share
over k²: the first round is as without any others, and ten rounds together raise 5 to 6 %, because the looks share most
of their rows (simulation of 60 independent groups; 40 rows and 40 more a round 5.7 %, 120 and 30 more 4.9 %).
Diagnosing again after an effect was added is no such round: it asks only where the round before has found something,
and a procedure that goes on only after a rejection keeps its rate (Marcus, Peritz & Gabriel 1976).
"""

from __future__ import annotations


def share(number: int) -> float:
    """Share of the first round's rate of false alarms that round `number` may spend; rounds are counted from 1."""
    return 1.0 / number**2
