"""Every law of the grammar: the written file, the search's columns and the law itself are one."""

from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib.effects import user
from pcalib.laws import writing
from pcalib.laws.channels import CHANNELS
from pcalib.laws.functions import SHAPES
from pcalib.laws.grammar import EACH, Law, laws, repeated, sharings

ROOT = Path(__file__).parents[2]
ROBOTS = ("delta", "hexapod", "linear_delta", "hexa")


def _every(robot, at) -> list[Law]:
    """One law of each channel, shape and variable, with sharings by turns."""
    out = []
    for channel, places, terms in laws(at):
        kept = {}
        for term in terms:
            kept.setdefault((term.shape.name, tuple(s.variable.words for s in term.variables)), term)
        ways = sharings(channel, places)
        out += [Law(channel, ways[i % len(ways)], term, places) for i, term in enumerate(kept.values())]
    return out


@pytest.fixture(scope="module", params=ROBOTS)
def grammar(request):
    robot = robots.load(ROOT / "models" / f"{request.param}.toml")
    at = user.trial(robot, ("humidity",), 40)
    return robot, at, _every(robot, at)


@pytest.mark.parametrize("kind", ["delta", "hexa", "hexa321", "h4", "linear_delta", "hexapod", "planar"])
def test_every_channel_that_suits_a_robot_acts_on_it(kind):
    """On the planar mechanism, too, whose motors turn no arms about a fixed axis."""
    robot = robots.load(ROOT / "models" / f"{kind}.toml")
    at = user.trial(robot, (), 20)
    for channel in CHANNELS:
        if channel.suits(robot.mechanism):
            moved = channel.contribution(at, np.ones((len(at), len(channel.names(robot.mechanism)))))
            assert moved.channels and all(np.isfinite(change).all() for _, change in moved.items()), channel.words


def test_written_files_are_the_laws(grammar, tmp_path):
    robot, at, every = grammar
    for law in every[:: max(1, len(every) // 60)]:
        theta = 1e-4 * np.random.default_rng(0).standard_normal(law.columns)
        name, classname = writing.names(law)
        (tmp_path / f"{name}.py").write_text(writing.written(law, theta, "data.csv"), encoding="utf-8")
        effect = user.load(f"{tmp_path / name}.py:{classname}", robot)
        here, there = law.contribution(at, theta), effect.contribution(at, theta)
        assert here.channels == there.channels
        assert [p.name for p in effect.parameters] == list(law.amplitudes)
        for channel in here.channels:  # constants are written with six digits
            assert getattr(there, channel) == pytest.approx(getattr(here, channel), rel=1e-4, abs=1e-12), law.words()


def test_laws_are_linear_in_their_amplitudes_and_nothing_at_zero(grammar):
    _, at, every = grammar
    for law in every[::5]:
        ones = np.eye(law.columns)
        sizes = 1e-4 * np.random.default_rng(1).standard_normal(law.columns)
        whole = law.contribution(at, sizes)
        for channel in whole.channels:
            parts = [getattr(law.contribution(at, one), channel) for one in ones]
            summed = np.tensordot(sizes, np.stack(parts), axes=1)
            assert getattr(whole, channel) == pytest.approx(summed, abs=1e-16)
            assert not getattr(law.contribution(at, 0 * sizes), channel).any()


def test_every_channel_and_shape_is_used_and_functions_are_of_size_one(grammar):
    robot, at, every = grammar
    assert {law.channel.words for law in every} == {c.words for c in CHANNELS if c.suits(robot.mechanism)}
    missing = {s.name for s in SHAPES} - {law.term.shape.name for law in every}
    assert missing <= {"step", "sine", "cube"}  # steps want twelve rows in time, sines and cubes an angle
    for law in every:
        largest = max(np.abs(f).max() for f in law.term.values(at))
        assert 0.05 < largest < 20 or law.term.shape.name in ("kink", "settling"), law.words()


def test_sharing_says_which_places_deviate(grammar):
    _, at, every = grammar
    law = next(law for law in every if law.channel.places == "arm" and law.term.per == "arm")
    for sharing in sharings(law.channel, law.places):
        made = Law(law.channel, sharing, law.term, law.places)
        moved = made.deviation(at, np.ones(made.columns)).any(axis=0)
        assert moved.sum() == (1 if sharing in law.places else len(law.places))
        assert made.columns == (len(law.places) if sharing == EACH else 1) * len(law.term.shape.text)


def test_a_rod_takes_the_value_of_its_arm(grammar):
    """On every robot of one or two rods per arm, and in the words of the law."""
    robot, at, every = grammar
    law = next(law for law in every if law.channel.places == "rod" and law.term.variables[0].variable.text == "at.q")
    made = Law(law.channel, "common", law.term, law.places)
    by_arm = made.term.values(at)[0]
    deviation = made.deviation(at, np.eye(made.columns)[0])
    assert np.array_equal(deviation, by_arm[:, robot.mechanism.actuator])
    assert "its arm's" in made.words()


def test_a_law_of_one_rod_by_a_direction_names_the_motor_and_comes_once(grammar):
    *_, every = grammar
    rods = [law for law in every if law.channel.places == "rod" and law.term.variables[0].variable.name == "dir"]
    assert {repeated(law.term, law.channel) for law in rods} == {True, False}
    assert all(repeated(law.term, law.channel) == (law.term.per == "arm") for law in rods if law.term.times is None)
