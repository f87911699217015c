"""Reading says what is wrong with a file; writing is whole or not at all."""

import os
import stat
import tracemalloc

import pytest

from pcalib import files
from pcalib.errors import InputError


@pytest.mark.parametrize(
    ("content", "problem", "line"),
    [
        (b"", "empty", None),
        (b" \n\t\n", "empty", None),
        (b"a\nb\xff\n", "not UTF-8", 2),
        ("é\n".encode("utf-16"), "not UTF-8", 1),
    ],
)
def test_read_refuses(tmp_path, content, problem, line):
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(InputError, match=problem) as caught:
        files.read_text(path)
    assert str(path) in str(caught.value)
    assert caught.value.line == line


def test_read_refuses_what_is_no_file(tmp_path):
    with pytest.raises(InputError, match="directory"):
        files.read_text(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        files.read_text(tmp_path / "absent")
    with pytest.raises(InputError, match="cannot be read"):
        files.read_text("/dev/null/x")


def test_read_drops_the_byte_order_mark(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"\xef\xbb\xbfq1_deg")
    assert files.read_text(path) == "q1_deg"


def test_write_keeps_the_old_file_when_it_fails(tmp_path):
    path = tmp_path / "file.csv"
    files.write_text(path, "old")
    with pytest.raises(RuntimeError), files.atomic(path) as temporary:
        temporary.write_text("half")
        assert temporary.suffix == ".csv"
        raise RuntimeError("the power fails")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.csv"]


def test_write_replaces_and_has_the_usual_rights(tmp_path):
    path, plain = tmp_path / "file", tmp_path / "plain"
    files.write_text(path, "old")
    files.write_text(path, "µm\n")
    plain.write_text("")
    assert path.read_bytes() == "µm\n".encode()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_write_refuses_where_it_cannot(tmp_path):
    with pytest.raises(InputError, match="directory"):
        files.write_text(tmp_path, "x")
    with pytest.raises(InputError, match="cannot write"):
        files.write_text(tmp_path / "absent" / "file", "x")


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    place = tmp_path / "deep" / "down"
    for error in (RuntimeError, OSError("full")):
        with pytest.raises((RuntimeError, InputError)), files.atomic_folder(place) as fresh:
            (fresh / "a").write_text("1")
            raise error
        assert list(tmp_path.iterdir()) == []
    with files.atomic_folder(place) as fresh:
        (fresh / "sub").mkdir()
        (fresh / "sub" / "a").write_text("1")
        assert not place.exists()
    assert [p.relative_to(tmp_path).as_posix() for p in sorted(tmp_path.rglob("*"))] == [
        "deep", "deep/down", "deep/down/sub", "deep/down/sub/a",
    ]  # fmt: skip


def test_a_folder_that_is_there_keeps_what_is_not_written_anew(tmp_path):
    (tmp_path / "sub").mkdir()
    for name in ("mine", "result"):
        (tmp_path / name).write_text("old")
    with files.atomic_folder(tmp_path) as fresh:
        (fresh / "result").write_text("new")
    assert (tmp_path / "mine").read_text() == "old" and (tmp_path / "result").read_text() == "new"
    with pytest.raises(InputError, match="a folder 'sub' in it already"), files.atomic_folder(tmp_path) as fresh:
        (fresh / "sub").mkdir()
        (fresh / "result").write_text("newer")
    assert (tmp_path / "result").read_text() == "new"
    for blocked in (tmp_path / "mine", tmp_path / "mine" / "below"):
        with pytest.raises(InputError, match="mine is a file"), files.atomic_folder(blocked):
            raise AssertionError("nothing is begun")


@pytest.mark.parametrize(
    "text", ["a." * 20_000 + "a = 1", "a = " + "{b = " * 200 + "1" + "}" * 200, "a = " + "9" * 5000]
)
def test_bombs_of_toml_are_refused_within_little_memory(text):
    tracemalloc.start()
    with pytest.raises(InputError, match=r"f\.toml(:1)?: .*(64 parts|64 deep|nested too deep|thousands of digits)"):
        files.parse_toml(text, "f.toml", "see the docs")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30e6


def test_long_texts_and_rows_of_numbers_are_no_dotted_keys():
    text = 'a = "' + "x.y " * 500 + '"\n' + "b = [" + "1.5, " * 500 + "]\n" + "# " + "-" * 100_000
    assert len(files.parse_toml(text, "f.toml", "")["b"]) == 500


def test_the_line_of_a_key():
    text = 'a = 1\n[x]\na_mm = 2\n[[m]]\nname = 1\n[[m]]\nname = 2\n[f]\nhose = {k = 1}\n'
    asked = [(None, "a"), ("x", "a"), ("m[2]", "name"), ("f.hose", "k"), ("x", None), ("spec", "a"), (None, None)]
    assert [files.line_of(text, *of) for of in asked] == [1, 3, 7, 9, 2, 1, None]


def test_the_shape_of_json():
    shape = {"a": [str], "b": (float, None), "c": {"*": float}}
    files.require_shape({"a": ["x"], "b": None, "c": {"k": 1}, "more": 0}, shape, "f", "")
    for value, said in (({"a": [1], "b": 1, "c": {}}, r"'a\[0\]' must be text"), ({"a": [], "c": {}}, "'b' is missing"),
                        ({"a": [], "b": True, "c": {}}, "'b' must be a finite"), ([], "the file must be an object"),
                        ({"a": [], "b": 1, "c": {"k": None}}, r"'c\.k' must be a finite number")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            files.require_shape(value, shape, "f", "")
