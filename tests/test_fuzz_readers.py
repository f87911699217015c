"""Any bytes, and valid files with anything done to them, either load or are refused: nothing else, and no crash."""

import os
import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcalib import inspection, robot
from pcalib.cli import main
from pcalib.data import measurement, targets
from pcalib.errors import InputError

MODELS = Path(__file__).resolve().parents[1] / "models"
DELTA = robot.load(MODELS / "delta.toml")
HEXAPOD = robot.load(MODELS / "hexapod.toml")
CASES = int(os.environ.get("PCALIB_FUZZ_CASES", "400"))
"""Cases of each of the seven sorts of fuzz; the command line gets half as many."""

fuzz = settings(
    max_examples=CASES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)

DATA = """\
# sigma_pos_mm = 0.02
# sigma_rot_deg = 0.005
# frame = base
# robot = delta
q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg,tool_x_mm,tool_y_mm,tool_z_mm,payload_kg,temp_degC,time_s,dir1,pose_id,set,sigma_pos_um,note
0,0,0,1,2,-817.1,0.1,0.2,-0.3,0,0,-100,0,20,0,1,7,fit,20,a
10,-20,5,12.5,-40,-800,0,0,0,0,0,-100,1.5,21.5,60,-1,7,check,20,b
-30,-30.5,-29,,,,0.5,0,0,0,0,-100,0,22,120,0,,fit,,c
-30,-30.5,-29,1,2,-900,,,,0,0,-100,0,22,180,0,9,fit,20,
-30,-30.5,-29,1,2,-900,,,,0,0,-100,0,22,180,0,9,fit,20,
"""
QUATERNIONS = """\
# frame = tracker
q1_mm,q2_mm,q3_mm,q4_mm,q5_mm,q6_mm,x_mm,y_mm,z_mm,qw,qx,qy,qz,humidity
1,2,3,4,5,6,1000,2,3,1,0,0,0,40
1,2,3,4,5,7,1000,2,3,0.6,0,0.8,0,41
"""
TARGETS = """\
x_mm,y_mm,z_mm,payload_kg,temp_degC,dir1,tool_x_mm,tool_y_mm,tool_z_mm,station
0,0,-800,0,20,1,0,0,-100,bin A
10.25,-20,-850.5,1.5,25,-1,0,0,-100,"bin B, left"
"""
TOML = (MODELS / "delta.toml").read_text(encoding="utf-8") + "\n[gravity]\nvector_m_s2 = [0.0, 0.0, -9.81]\n"
TOKENS = [
    "", ",", "\n", "\r", '"', "'", "#", "=", "# frame = tracker\n", "nan", "inf", "-1e308", "1e308", "1e-320", "1e999",
    "9" * 400, "1e29", "0", "-0", "1_0", "٣", "\x00", "\ufeff", "\u2028", "_mm", "_deg", "_furlong", "x_mm", "q1_rad",
    "q4_deg", "dir2", "set", "check", "qw", "rx_deg", "temp_arms_degC", "pose_id", "[", "]", "[[", "{", "}",
    "[geometry]",
    "[drive]\nripple_per_turn = ", 'kind = "planar"', 'kind = "hexapod"', "true", "1979-05-27", "name.x", "[" * 3000,
    '"""', "\\", "\t", ";", "é", "🤖",
]  # fmt: skip


@st.composite
def mutated(draw, *valid):
    """A valid file with cells, lines and pieces removed, repeated, swapped or replaced."""
    text = str(draw(st.sampled_from(valid)))
    dice = random.Random(draw(st.integers(0, 2**32)))
    for _ in range(draw(st.integers(1, 4))):
        token, at = dice.choice(TOKENS), dice.randrange(len(text) + 1)
        to = min(len(text), at + dice.choice([1, 1, 2, 5, 40]))
        lines = text.split("\n")
        row = dice.randrange(len(lines))
        match dice.randrange(7):
            case 0:
                text = text[:at] + text[to:]
            case 1:
                text = text[:at] + token + text[at:]
            case 2:
                text = text[:at] + token + text[to:]
            case 3:
                text = "\n".join([*lines[:row], lines[dice.randrange(len(lines))], *lines[row:]])
            case 4:
                text = "\n".join(lines[:row] + lines[row + 1 :])
            case 5 | 6:  # one cell or value
                separator = "," if "," in lines[row] else "="
                cells: list[str] = list(lines[row].split(separator))
                cells[dice.randrange(len(cells))] = token if dice.random() < 0.8 else repr(dice.gauss(0, 1000))
                lines[row] = separator.join(cells)
                text = "\n".join(lines)
    data = text.encode("utf-8", "surrogatepass")
    if draw(st.booleans()) and data:
        spot = dice.randrange(len(data))
        data = data[:spot] + bytes([dice.randrange(256)]) + data[spot + dice.randrange(2) :]
    return data


def attempt(reader, path: Path, data: bytes, described):
    """What a reader makes of the bytes, or None where it refuses them as it should."""
    path.write_bytes(data)
    try:
        return reader(path, *described)
    except InputError as error:
        assert str(path) in str(error) and error.problem
        return None


def check_measurements(data):
    assert len(data) > 0
    for values in (data.q, data.tool, data.payload, data.sigma, *data.columns.values()):
        assert np.isfinite(values).all()
    assert (data.sigma > 0).all()
    assert (np.isfinite(data.position) == data.mask[:, :3]).all()
    R = data.rotation[data.mask[:, 3]]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)


@fuzz
@given(st.binary(max_size=300) | st.text(max_size=200).map(lambda t: t.encode("utf-8", "surrogatepass")))
def test_any_bytes(tmp_path, data):
    loaded = attempt(measurement.load, tmp_path / "a.csv", data, [DELTA])
    assert loaded is None, "no robot's file is a handful of random bytes"
    attempt(measurement.load, tmp_path / "a.csv", data, [])
    attempt(targets.load_targets, tmp_path / "t.csv", data, [DELTA])
    attempt(robot.load, tmp_path / "r.toml", data, [])
    attempt(measurement.load, tmp_path / "a.parquet", data, [DELTA])


@fuzz
@given(mutated(DATA))
def test_mutated_measurements(tmp_path, data):
    loaded = attempt(measurement.load, tmp_path / "a.csv", data, [DELTA])
    if loaded is not None:
        check_measurements(loaded)
        inspection.inspect(loaded, DELTA).to_json()
        measurement.save(tmp_path / "b.csv", loaded)
        again = measurement.load(tmp_path / "b.csv", DELTA)
        np.testing.assert_allclose(again.q, loaded.q, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(again.position, loaded.position, rtol=1e-13, atol=1e-15)


@fuzz
@given(mutated(DATA, QUATERNIONS))
def test_mutated_measurements_without_a_robot_and_of_a_hexapod(tmp_path, data):
    for described in ([], [HEXAPOD]):
        loaded = attempt(measurement.load, tmp_path / "a.csv", data, described)
        if loaded is not None:
            check_measurements(loaded)
            inspection.inspect(loaded)


@fuzz
@given(mutated(TARGETS))
def test_mutated_targets(tmp_path, data):
    loaded = attempt(targets.load_targets, tmp_path / "t.csv", data, [DELTA])
    if loaded is not None:
        assert np.isfinite(loaded.position).all() and np.isfinite(loaded.orientation).all()
        targets.save_commands(tmp_path / "c.csv", DELTA, loaded, np.zeros((len(loaded), 3)), ["ok"] * len(loaded))
        q, status = targets.load_commands(tmp_path / "c.csv", DELTA)
        assert len(q) == len(loaded) and (status == "ok").all()


@fuzz
@given(mutated(TOML, *(p.read_text(encoding="utf-8") for p in sorted(MODELS.glob("*.toml")))))
def test_mutated_robots(tmp_path, data):
    loaded = attempt(robot.load, tmp_path / "r.toml", data, [])
    if loaded is not None:
        assert np.isfinite(loaded.mechanism.nominal).all()
        assert loaded.joint_min < loaded.joint_max


@pytest.fixture(scope="module")
def parquet(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parquet")
    (folder / "a.csv").write_text(DATA, encoding="utf-8")
    measurement.save(folder / "a.parquet", measurement.load(folder / "a.csv", DELTA))
    return (folder / "a.parquet").read_bytes()


@fuzz
@given(st.data())
def test_mutated_parquet(tmp_path, parquet, data):
    spot = data.draw(st.integers(0, len(parquet) - 1))
    kept = data.draw(st.integers(0, len(parquet)))
    byte = data.draw(st.binary(min_size=1, max_size=3))
    broken = data.draw(st.sampled_from([parquet[:kept], parquet[:spot] + byte + parquet[spot + len(byte) :]]))
    loaded = attempt(measurement.load, tmp_path / "a.parquet", broken, [DELTA])
    if loaded is not None:
        check_measurements(loaded)


@settings(fuzz, max_examples=CASES // 2)
@given(data=mutated(DATA))
def test_the_command_line_says_one_thing_and_leaves_nothing_half_written(tmp_path, data, capsys):
    path, out = tmp_path / "a.csv", tmp_path / "out.json"
    path.write_bytes(data)
    out.unlink(missing_ok=True)
    code = main(["inspect", str(path), "--robot", str(MODELS / "delta.toml"), "--json", str(out)])
    printed = capsys.readouterr()
    assert code in (0, 2)
    assert (code == 2) == printed.err.startswith("error: ")
    assert printed.err.count("error:") <= 1 and "Traceback" not in printed.err
    assert set(os.listdir(tmp_path)) <= {"a.csv", "out.json"}
    assert out.exists() or code == 2
