"""Nothing hidden, and noise as instruments make it: how often something is found, and how often a cause is named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench import faults, simulate
from bench import plan as plans
from bench.instrument import Instrument
from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import KINDS, in_words, robot, stage
from bench.jobs.hidden.design import DESIGNS, POINTS, TRACKED, Design
from bench.truth import Truth
from pcalib.diagnosis.diagnose import diagnose
from pcalib.laws.verdict import with_laws

SETS, FEWER = 200, 120
"""Data sets of a variant, and of those that stand beside another for comparison."""
BESIDE = (
    "white_positions", "plain", "plain_positions", "sigma_understated", "sigma_overstated", "range_angle_stated",
    "reflectors_three_points", "reflectors_stated", "bed_contacts_checked", "few_contacts",
)  # fmt: skip
RICH = DESIGNS["rich"]
FAR = (0.0, 0.0, -0.2)
"""[m] tool point that is far from reflectors on the plate."""


@dataclass(frozen=True)
class _Variant:
    """A design, what is stated of its noise, and what stands in the robot besides."""

    design: Design
    kinds: tuple[str, ...] = KINDS
    fault: tuple[str, Mapping[str, float]] | None = None
    level: str = "complete"
    visible: bool = False
    """Whether what stands in the robot can be seen, so that an alarm is right."""


def _rich(**settings) -> Design:
    return replace(RICH, instrument_settings=settings)


ENCODER = {bits: ("encoder_steps", {"step_rad": 2 * np.pi / 2**bits}) for bits in (15, 18)}
TRACKER = {name: value for name, value in TRACKED.items() if name not in ("noise", "state_covariance")}
REFLECTORS = {"noise": "reflectors"}
VARIANTS = {
    "white": _Variant(RICH),
    "white_positions": _Variant(DESIGNS["rich-position"]),
    "plain": _Variant(DESIGNS["plain"]),
    "plain_positions": _Variant(DESIGNS["plain-position"]),
    "sigma_understated": _Variant(DESIGNS["rich-understated"]),
    "sigma_overstated": _Variant(DESIGNS["rich-overstated"]),
    "growing_with_range": _Variant(_rich(sigma_distance=1.5e-5, position=(1.5, -0.8, 0.2))),
    "range_angle_one_sigma": _Variant(_rich(noise="range_angle", **TRACKER)),
    "range_angle_stated": _Variant(DESIGNS["tracker"]),
    "camera": _Variant(_rich(noise="camera", sigma_depth=8e-5, sigma_out=2e-4, frame="tracker")),
    "read_out_steps": _Variant(_rich(resolution_pos=3e-5, resolution_rot=1e-4)),
    "heavy_tails": _Variant(_rich(noise="heavy_tails")),
    "correlated": _Variant(_rich(noise="correlated")),
    "correlated_apart": _Variant(replace(_rich(noise="correlated"), apart=True)),
    "reflectors_near": _Variant(replace(_rich(**REFLECTORS), points=POINTS[:1])),
    "reflectors_far": _Variant(replace(_rich(**REFLECTORS), points=(FAR,))),
    "reflectors_three_points": _Variant(_rich(**REFLECTORS)),
    "reflectors_stated": _Variant(_rich(state_covariance=True, **REFLECTORS)),
    "ballbar_and_inclinometer": _Variant(DESIGNS["ballbar"], ("delta", "hexa321", "delta", "h4")),
    "encoder_18_bits": _Variant(RICH, ("delta", "hexa", "h4", "delta"), ENCODER[18]),
    "encoder_15_bits": _Variant(RICH, ("delta", "hexa", "h4", "delta"), ENCODER[15], visible=True),
    "bed_contacts": _Variant(replace(RICH, plan="contacts", rows=37, check=0), ("linear_delta",), level="firmware6"),
    "bed_contacts_checked": _Variant(
        replace(RICH, plan="contacts", rows=37, check=12), ("linear_delta",), level="firmware6"
    ),
    "few_contacts": _Variant(replace(RICH, plan="contacts", rows=10, check=0), ("linear_delta",), level="firmware6"),
    "few_rows": _Variant(replace(RICH, rows=16, check=5)),
}


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    variant = VARIANTS[task.variant]
    kind = variant.kinds[task.number % len(variant.kinds)]
    if variant.design.plan == "contacts":
        yield from _contacts(task, variant, kind, rng)
        return
    there = stage(variant.design, kind, rng)
    fault = () if variant.fault is None else (faults.make(there.robot, *variant.fault),)
    landing = there.land(fault)
    for _ in range(task.sets):
        data = there.measure(fault, landing, int(rng.integers(2**31)))
        yield Set(there.robot, data, kind, {"visible": variant.visible})


CONTACT_NOISE = 3e-5
"""[m] 1σ of a bed contact."""


def _contacts(task: Task, variant: _Variant, kind: str, rng: np.random.Generator) -> Iterator[Set]:
    """Yield contacts of a level bed, touched at random places by a robot with errors of the level that is fitted."""
    nominal = robot(kind)
    basis = nominal.mechanism.levels[variant.level].basis
    scale = np.where(np.array(nominal.mechanism.units) == "m", 2e-4, 1e-3)
    bed = nominal.workspace.z_min
    instrument = Instrument(kind="contact", bed=bed, sigma_pos=CONTACT_NOISE)
    for _ in range(task.sets):
        # A perfect printer every other time: nothing in its geometry then hides what the noise does.
        errors = basis @ np.linalg.lstsq(basis, scale * rng.standard_normal(len(scale)), rcond=None)[0]
        truth = Truth(nominal, errors * rng.integers(2), instrument)
        total = variant.design.rows + variant.design.check
        plan = plans.make(nominal, "random", total, seed=int(rng.integers(2**31)))
        plan = replace(plan, check=np.arange(total) >= variant.design.rows)
        data = simulate.run(truth, plan, int(rng.integers(2**31))).measurements
        yield Set(nominal, data, kind, level=variant.level)


def _judge(made: Set) -> Said:
    found = with_laws(diagnose(made.model, made.data))
    hits = {} if made.truth.get("visible") else {"alarm": found.verdict != "nothing_missing"}
    return Said(in_words(found), hits | {"wrong": bool(found.established)})


ROW = Row(
    "noise",
    {variant: FEWER if variant in BESIDE else SETS for variant in VARIANTS},
    {
        "alarm": Bound("nothing hidden, {}: something found", 0.05),
        "wrong": Bound("nothing hidden, {}: an effect called established", 0.01),
    },
    _sets,
    _judge,
)
