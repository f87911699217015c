"""Parquet: what a typed file may hold, and how much."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pcalib.data import table
from pcalib.errors import InputError


def test_types(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(
        pa.table({"x": [1.5, None], "n": [1, 2], "flag": [True, None], "word": [" a ", None], "nothing": pa.nulls(2),
                  "kind": pa.array(["b", "b"]).dictionary_encode()}), path,
    )  # fmt: skip
    columns = table.read(path).columns
    assert columns["word"] == ["a", ""] and columns["kind"] == ["b", "b"]
    for name, values in (("x", [1.5, np.nan]), ("n", [1, 2]), ("flag", [1, np.nan]), ("nothing", [np.nan] * 2)):
        np.testing.assert_array_equal(columns[name], values)


def test_a_bomb_is_refused_before_it_unpacks(tmp_path):
    """A constant column of 6e7 rows is a file of some kilobytes, and half a gigabyte when it is read."""
    path = tmp_path / "a.parquet"
    with pq.ParquetWriter(path, pa.schema([("x_mm", pa.float64())])) as out:
        zeros = pa.table({"x_mm": np.zeros(10_000_000)})
        for _ in range(6):
            out.write_table(zeros)
    before = pa.total_allocated_bytes()
    with pytest.raises(InputError, match=r"60000000 rows of 1 columns are more than can be held\n.*at most 50000000"):
        table.read(path)
    assert path.stat().st_size < 1e6 and pa.total_allocated_bytes() - before < 10e6
    pq.write_table(pa.table({"x": [[1.0], [2.0]]}), path)
    with pytest.raises(InputError, match="cannot be used\n  store numbers or text"):
        table.read(path)


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null"])
def test_devices_are_no_tables(device):
    with pytest.raises(InputError, match="is a device, not a file"):
        table.read(device)
