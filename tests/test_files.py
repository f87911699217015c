"""Reading says what is wrong with a file; writing is whole or not at all."""

import os
import stat

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
