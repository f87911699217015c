"""Readings and commands that come in two files: paired right or listed, never guessed."""

import itertools

import numpy as np
import pytest

from pcalib import prediction, rotation
from pcalib.cli import main
from pcalib.data import measurement, table
from pcalib.errors import InputError
from pcalib.model import Conditions, Model
from pcalib.recordings import Recording, dwells, pairing
from pcalib.workspace import reachable


def session(seed):
    """Commands, some twice in a row; a tenth of the readings lost, a tenth read again or of no command."""
    rng = np.random.default_rng(seed)
    m = int(rng.integers(30, 80))
    points = rng.uniform([-0.3, -0.3, -0.9], [0.3, 0.3, -0.7], (m, 3))
    commands = np.repeat(points, np.where(rng.random(m) < 0.15, 2, 1), axis=0)[:m]
    true = commands + commands @ (1e-3 * rng.standard_normal((3, 3))) + 5e-4 * np.sin(20 * commands)
    made = [(true[i], i) for i in np.sort(rng.permutation(m)[: int(0.9 * m)])]
    for _ in range(m // 10):
        at = int(rng.integers(len(made)))
        made.insert(at, made[at] if rng.random() < 0.5 else (rng.uniform([-0.3, -0.3, -0.9], [0.3, 0.3, -0.7]), -1))
    x = np.array([point for point, _ in made]) + 2e-5 * rng.standard_normal((len(made), 3))
    x = x @ rotation.exp(rng.standard_normal(3)).T + rng.standard_normal(3)
    return commands, x, np.array([i for _, i in made])


def test_by_order_with_a_tenth_lost_and_a_tenth_added():
    wrong = right = belong = 0
    for seed in range(40):
        commands, x, own = session(seed)
        found = pairing.by_order(x, commands)
        of = own[found.reading]
        same = (of >= 0) & (np.linalg.norm(commands[of] - commands[found.command], axis=1) < 1e-9)
        wrong, right, belong = wrong + np.sum(~same), right + np.sum(same), belong + np.sum(own >= 0)
        assert set(found.extra) | set(found.reading) == set(range(len(x)))
    assert wrong == 0 and right >= 0.99 * belong


def test_readings_of_another_session_are_refused():
    commands, x, _ = session(1)
    with pytest.raises(InputError, match="check that both files belong together"):
        pairing.by_order(np.random.default_rng(0).uniform(-0.3, 0.3, x.shape), commands)


def test_by_name_and_by_time():
    named = pairing.by_name(["a", "c", "x", "a"], ["a", "b", "a", "c"])
    assert list(zip(named.reading, named.command, strict=True)) == [(0, 0), (1, 3), (3, 2)]
    assert named.lost.tolist() == [1] and named.extra.tolist() == [2]
    timed = pairing.by_time(np.array([0.2, 10.1, 14.9, 30.0]), np.array([0.0, 10.0, 20.0, 30.0]))
    assert list(zip(timed.reading, timed.command, strict=True)) == [(0, 0), (1, 1), (3, 3)]


def stops(points, rate=100.0, wait=1.0, move=0.5):
    rng = np.random.default_rng(0)
    x = [points[0]]
    for a, b in itertools.pairwise(points):
        x += [a] * int(wait * rate) + [a + (b - a) * s for s in np.linspace(0, 1, int(move * rate))]
    x += [points[-1]] * int(wait * rate)
    x = np.array(x) + 1e-5 * rng.standard_normal((len(x), 3))
    return Recording(x, np.tile(np.eye(3), (len(x), 1, 1)), np.arange(len(x)), "r.csv", time=np.arange(len(x)) / rate)


def test_stops_are_found():
    points = np.random.default_rng(1).uniform(-0.2, 0.2, (12, 3))
    found = dwells.dwells(stops(points))
    assert len(found) == 12 and np.abs(found.position - points).max() < 1e-5 and "12 stops" in found.notes[-1]
    assert np.abs(np.diff(found.time) - 1.5).max() < 0.05
    with pytest.raises(InputError, match="stands still nowhere"):
        dwells.dwells(stops(points, wait=0.05))


@pytest.fixture
def files(delta, tmp_path):
    """A file of commands, and a robot that is a little off, measured as a list of points."""
    q = reachable(delta, 20, np.random.default_rng(3)).q
    k = delta.mechanism.nominal + 1e-4 * np.random.default_rng(4).standard_normal(60)
    p = prediction.predict(Model(delta, k, "complete"), q, Conditions.of(20))
    x = p.position @ rotation.exp(np.array([0.1, 0.2, 2.0])).T + [1.0, 2.0, 0.5]
    columns = {f"q{i + 1}_deg": np.degrees(q[:, i]) for i in range(3)}
    table.write(tmp_path / "c.csv", columns | {"name": [f"P{i}" for i in range(20)]}, {})
    rows = [f"P{i};" + ";".join(f"{1e3 * v:.4f}".replace(".", ",") for v in x[i]) for i in range(20) if i != 7]
    (tmp_path / "points.txt").write_text("\n".join([*rows, "P99;1,0;2,0;3,0"]))
    return tmp_path, x


@pytest.mark.parametrize("by", ["name", "order"])
def test_the_command_pairs_and_lists(files, by, delta, capsys):
    folder, x = files
    options = ["--robot", "delta", "--commands", str(folder / "c.csv"), "--pair", by, "--set", "sigma_pos=20um"]
    code = main(["import", "point-list", str(folder / "points.txt"), *options, "-o", str(folder / "data.csv")])
    said = " ".join(capsys.readouterr().out.split())
    assert code in (0, None) and "19 readings paired with 19 of 20 commands" in said
    assert "1 command without a reading, on line 9" in said and "1 reading without a command, on line 20" in said
    data = measurement.load(folder / "data.csv", delta)
    assert data.frame == "tracker" and np.allclose(data.position, np.delete(x, 7, axis=0), atol=1e-7)
    assert np.allclose(data.sigma[:, :3], 20e-6)


def test_what_is_missing_is_asked_for(files, capsys):
    folder, _ = files
    assert main(["import", "point-list", str(folder / "points.txt"), "-o", str(folder / "d.csv")]) == 2
    assert "--commands" in capsys.readouterr().err
    assert main(["import", "vikon", "x"]) == 2
    assert "vicon" in capsys.readouterr().err
