"""What the benchmark asks: one cell is one robot, one design and one kind of fault, tried at several sizes."""

from __future__ import annotations

from dataclasses import dataclass

from bench.jobs.hidden import catalogue
from bench.jobs.hidden.catalogue import CATALOGUE
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.stage import suits
from pcalib.robot import Robot

CURVE = (3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0)
"""Sizes s of the power curve; s = 0 are the cells with nothing hidden."""
FAR = (8.0, 12.0, 20.0)
"""Sizes s⊥ of pairs and of faults that no library lists."""
RICH = ("rich", "rich-position")
PLAIN = ("plain", "plain-position")
MISSTATED = ("rich-understated", "rich-overstated")
LARGE = 20.0
"""s at which an effect is added and the robot compensated."""


@dataclass(frozen=True)
class Cell:
    """One robot with one thing to find."""

    number: int
    part: str
    """'none', 'single', 'pair', 'outside', 'add'."""
    design: str
    what: tuple[str, ...] = ()
    """Names of the catalogue; of a pair drawn at random: empty."""
    sizes: tuple[float, ...] = (0.0,)
    noises: int = 1
    """Data sets per size, with noise of their own."""
    uneven: bool = False
    """Whether arms differ."""
    named: bool = False
    """Whether the robot file names the cycles per turn of its gears; else a ripple has to be searched for."""
    without: bool = False
    """Whether the truth is taken out of the library, which makes it something that no library lists."""

    @property
    def trials(self) -> int:
        """Data sets that it diagnoses."""
        return len(self.sizes) * self.noises


def cells(robot: Robot, quick: bool = False) -> list[Cell]:
    """All cells, in a fixed order: number and seed fix everything about one."""
    made: list[Cell] = []

    def add(part: str, design: str, **more) -> None:
        made.append(Cell(len(made), part, design, **more))

    def suited(names: tuple[str, ...], design: str) -> list[str]:
        return [name for name in names if suits(CATALOGUE[name], DESIGNS[design], robot)]

    robots, noises = (2, 1) if quick else (24, 5)
    for design in (*RICH, *PLAIN, *MISSTATED) if not quick else ("rich", "plain", "rich-understated"):
        for _ in range(robots):
            add("none", design, noises=noises)

    if quick:
        for name in ("drive_compliance", "thermal_rods", "backlash"):
            add("single", "rich", what=(name,), sizes=(6.0, 12.0))
        add("pair", "rich", sizes=(8.0,))
        add("outside", "rich", what=("encoder_warming",), sizes=(12.0,))
        add("outside", "rich", what=("thermal_arms",), sizes=(12.0,), without=True)
        add("add", "rich", what=("rod_compliance",), sizes=(LARGE,))
        return made

    for design, robots in (("rich", 4), ("rich-position", 3), ("plain", 2), ("plain-position", 2)):
        for name in suited(catalogue.LISTED, design):
            for i in range(robots):
                add("single", design, what=(name,), sizes=CURVE, uneven=i % 3 == 2, named=i % 2 == 0)
    for design in MISSTATED:
        for name in suited(catalogue.LISTED, design):
            add("single", design, what=(name,), sizes=(6.0, 12.0))
    for design, count in (("rich", 100), ("rich-position", 40), ("rich-overstated", 20)):
        for i in range(count):
            add("pair", design, sizes=(FAR[i % 2],))
    for design, robots in (("rich", 4), ("rich-position", 4)):
        for name in catalogue.UNLISTED:
            for _ in range(robots):
                add("outside", design, what=(name,), sizes=FAR)
        for name in suited(catalogue.LISTED, design):
            if not CATALOGUE[name].companion and name != "tracker_drift":
                add("outside", design, what=(name,), sizes=FAR, without=True)
    for name in suited(catalogue.LISTED, "rich"):
        if name != "tracker_drift":  # to the library it is base drift, and has its cell there
            for _ in range(2):
                add("add", "rich", what=(name,), sizes=(LARGE,))
    return made
