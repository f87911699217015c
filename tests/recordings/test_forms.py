"""Small files of every form, as instruments write them, read to the same numbers."""

import random

import numpy as np
import pytest

from pcalib import recordings, rotation
from pcalib.errors import InputError

P = np.array([[0.0125, -0.0401, -0.8002], [0.1, 0.2, -0.75]])
R = rotation.exp(np.array([[0.01, -0.02, 0.03], [0.0, 0.0, 0.1]]))


def numbers(values):
    return " ".join(f"{v:.9f}" for v in np.ravel(values))


def matrix(i, factor=1e3, transposed=False, bottom=True):
    H = np.eye(4)
    H[:3, :3], H[:3, 3] = R[i], factor * P[i]
    H = H.T if transposed else H if bottom else H[:3]
    return numbers(H)


MOTIVE = """Format Version,1.23,Take Name,t,Capture Frame Rate,100,Rotation Type,Quaternion,Length Units,Meters

,Type,{types}
,Name,{names}
,ID,{ids}
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z
"""


def motive(**changes):
    head = MOTIVE.format(types=",".join(["Rigid Body"] * 7), names=",".join(["plate"] * 7), ids=",".join(["1"] * 7))
    rows = []
    for i, (x, q) in enumerate(zip(P, rotation.to_quaternion(R), strict=True)):
        w, *v = q
        rows.append(f"{i},{0.01 * i:.2f},{','.join(f'{c:.9f}' for c in (*v, w, *x))}")
    text = head + "\n".join([*rows, "2,0.02,,,,,,,"])
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    return text


def vicon(angle="rad", length="mm"):
    rows = []
    for i, (x, v) in enumerate(zip(P, rotation.log(R), strict=True)):
        v = np.degrees(v) if angle == "deg" else v
        rows.append(f"{i + 1},0,{','.join(f'{c:.9f}' for c in (*v, *(x * (1e3 if length == 'mm' else 1))))}")
    units = ",".join([angle] * 3 + [length] * 3)
    head = f"Objects\n100\n,,plate\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,{units}\n"
    return head + "\n".join([*rows, "3,0,,,,,,"])


POINTS = [("P1", 1e3 * P[0]), ("P2", 1e3 * P[1])]
LISTS = {
    "spatial analyzer": "// SA export\n" + "\n".join(f"A::Main::{n}, {x[0]}, {x[1]}, {x[2]}" for n, x in POINTS),
    "polyworks": "Name X[mm] Y[mm] Z[mm]\n" + "\n".join(f'"{n}" {numbers(x)}' for n, x in POINTS),
    "leica": "\n".join(f"{n};" + ";".join(f"{v:.6f}".replace(".", ",") for v in x) for n, x in POINTS),
    "faro": "# FARO\nUnits: m\n" + "\n".join(f"{n} {numbers(x / 1e3)}".replace(" ", "\t") for n, x in POINTS),
    "blanks, decimal commas": "\n".join(f"{n} {numbers(x).replace('.', ',')}" for n, x in POINTS),
    "byte order mark": "\ufeffname,x,y,z\n" + "\n".join(f"{n},{x[0]},{x[1]},{x[2]}" for n, x in POINTS),
    "inches": "X [in]\n" + "\n".join(f"{n} {numbers(x / 25.4)}" for n, x in POINTS),
}
FILES = {name: ("point-list", text) for name, text in LISTS.items()} | {
    "3 by 4": ("matrices", "\n".join(matrix(i, bottom=False) for i in range(2))),
    "4 by 4": ("matrices", "\n".join(matrix(i).replace(" ", ";") for i in range(2))),
    "4 by 4, transposed, metres": ("matrices", "pose [m]\n" + "\n".join(matrix(i, 1.0, True) for i in range(2))),
    "4 by 4, named": ("matrices", "\n".join(f"P{i + 1} {matrix(i)}" for i in range(2))),
    "motive": ("motive", motive()),
    "motive, millimetres": ("motive", motive(Meters="Millimeters")),
    "vicon": ("vicon", vicon()),
    "vicon, degrees and metres": ("vicon", vicon("deg", "m")),
}


@pytest.mark.parametrize("name", FILES)
def test_every_form_is_read(tmp_path, name):
    form, text = FILES[name]
    (tmp_path / "f.txt").write_text(text, encoding="utf-8")
    found = recordings.FORMS.get(form).read(tmp_path / "f.txt")
    assert np.abs(found.position - (P / 1e3 if name == "motive, millimetres" else P)).max() < 1e-8
    if form == "point-list":
        assert found.label == ("P1", "P2") and np.isnan(found.rotation).all()
    else:
        assert np.abs(found.rotation - R).max() < 1e-7
    assert (found.time is not None) == (form in ("motive", "vicon"))
    if form in ("motive", "vicon"):
        assert any("lost are left out" in note for note in found.notes)


@pytest.mark.parametrize(
    "form, text, problem",
    [
        ("point-list", "hello\n1 2\n", "a name and three numbers"),
        ("matrices", "1 2 3\n", "12 or 16 numbers"),
        ("matrices", "1 0 0 5 0 2 0 5 0 0 1 5\n", "no rotation and position"),
        ("motive", "a,b\n", "Motive export"),
        ("motive", motive(Quaternion="XYZ"), "rotations are 'XYZ'"),
        ("motive", motive(Meters="Ells"), "length unit 'ells' is unknown"),
        ("vicon", "Objects\n100\n", "Vicon export"),
        ("vicon", vicon("grad"), "units 'grad'"),
    ],
)
def test_files_of_other_forms_are_refused(tmp_path, form, text, problem):
    (tmp_path / "f.txt").write_text(text)
    with pytest.raises(InputError, match=problem):
        recordings.FORMS.get(form).read(tmp_path / "f.txt")


@pytest.mark.parametrize("name", FILES)
def test_damaged_files_are_read_or_refused(tmp_path, name):
    form, text = FILES[name]
    rng = random.Random(name)
    for _ in range(40):
        damaged = bytearray(text.encode())
        for _ in range(rng.randint(1, 5)):
            i = rng.randrange(len(damaged))
            what = rng.choice(["byte", "cut", "insert", "shuffle"])
            if what == "byte":
                damaged[i] = rng.randrange(256)
            elif what == "cut":
                del damaged[i : i + 12]
                damaged = damaged or bytearray(b"\n")
            elif what == "insert":
                damaged[i:i] = rng.choice([b"nan", b"1e999", b",,", b";", b"\n", b'"', b"\0", b"0"])
            else:
                lines = bytes(damaged).split(b"\n")
                rng.shuffle(lines)
                damaged = bytearray(b"\n".join(lines) or b"\n")
        (tmp_path / "f.txt").write_bytes(damaged)
        try:
            found = recordings.FORMS.get(form).read(tmp_path / "f.txt")
        except InputError:
            continue
        assert len(found) and np.isfinite(found.position).all()


def test_numbers_behind_points_are_said_to_be_unread(tmp_path):
    text = "\n".join(f"P{i}, 10.5, {i}.0, -800.25, 1.5, 0.25, -0.5" for i in range(4))
    (tmp_path / "p.txt").write_text(text)
    found = recordings.FORMS.get("point-list").read(tmp_path / "p.txt")
    assert any("behind 4 of 4 points and are not read" in note for note in found.notes)
