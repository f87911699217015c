"""Tables with their source lines, the form of every data file: CSV with a head of metadata, or Parquet.

CSV is UTF-8 with commas: lines ``# key = value`` (a ``#`` line without ``=`` is a comment), one header line, one
line per row. Parquet holds the same columns, null for blank, with the metadata beside the schema; its "lines" are
row numbers from 1.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from pcalib import files
from pcalib.errors import InputError
from pcalib.wording import short

if TYPE_CHECKING:
    import pyarrow as pa

PARQUET = (".parquet", ".pq")
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
"""Bytes that no text has."""
_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
LARGEST = 1e30
"""Numbers in files stay below this, so that no square or unit overflows later on."""
MOST_CELLS = 50_000_000
"""Numbers in a Parquet file, which may unpack to a thousand times its own size; 1e6 rows of 20 columns are a half."""


@dataclass(frozen=True)
class Table:
    """The cells of a file, not yet interpreted."""

    source: str
    columns: Mapping[str, Sequence[str] | np.ndarray]
    """Name → stripped text of each cell, or (N,) float with NaN for null where the file itself is typed."""
    lines: np.ndarray
    """(N,) int, line of each row in the file."""
    metadata: Mapping[str, str]
    metadata_lines: Mapping[str, int]
    comments: Mapping[int, str]
    """Line → text of the '#' lines without '='."""
    header_line: int | None = None

    def __len__(self) -> int:
        return len(self.lines)

    def error(self, problem: str, *, row: int | None = None, column: str | None = None, remedy: str = "") -> InputError:
        """An error at a row (0-based), or at the header."""
        line = self.header_line if row is None else int(self.lines[row])
        return InputError(problem, file=self.source, line=line, column=column, remedy=remedy)

    def metadata_error(self, key: str, problem: str, remedy: str) -> InputError:
        """An error at the line of a metadata key."""
        return InputError(problem, file=self.source, line=self.metadata_lines.get(key), remedy=remedy)

    def blank(self, name: str) -> np.ndarray:
        """(N,) which cells of a column are empty."""
        cells = self.columns[name]
        if isinstance(cells, np.ndarray):
            return np.isnan(cells)
        return np.fromiter((not cell for cell in cells), bool, len(cells))

    def texts(self, name: str) -> list[str]:
        """The cells as text; '' for blank."""
        cells = self.columns[name]
        return _formatted(cells) if isinstance(cells, np.ndarray) else list(cells)

    def numbers(self, name: str, *, blank: bool = False) -> np.ndarray:
        """The cells as (N,) float in the column's own unit; NaN for blank, which is an error unless `blank`.

        Raises:
            InputError: a cell that is no finite number, or is blank where a value is needed.
        """
        cells = self.columns[name]
        if isinstance(cells, np.ndarray):
            values = cells
        else:
            try:
                values = np.array([float(cell) if cell else np.nan for cell in cells])
            except ValueError:
                self._refuse_number(name, cells, blank)
            joined = "".join(cells)
            if "_" in joined or not joined.isascii():  # float() takes 1_000 and digits of other scripts
                self._refuse_number(name, cells, blank)
        sound = np.abs(values) < LARGEST
        if not sound.all():
            empty = self.blank(name)
            wrong = ~sound & ~empty
            if wrong.any():
                row = int(np.argmax(wrong))
                self._refuse_cell(name, row, self.texts(name)[row], blank)
            if empty.any() and not blank:
                raise self.error(
                    "the field is blank", row=int(np.argmax(empty)), column=name,
                    remedy="every row needs a number here; only measured pose columns may be blank",
                )
        return values

    def _refuse_number(self, name: str, cells: Sequence[str], blank: bool) -> NoReturn:
        row = next(i for i, cell in enumerate(cells) if cell and not is_number(cell))
        self._refuse_cell(name, row, cells[row], blank)

    def _refuse_cell(self, name: str, row: int, cell: str, blank: bool) -> NoReturn:
        remedy = "write a plain decimal number such as -12.5"
        if "," in cell and "." in cell:
            remedy = "leave out what groups the thousands: 2448.7435, not 2.448,7435"
        elif "," in cell:
            remedy = "write decimals with a point, not a comma"
        elif blank:
            remedy += ", or leave the field blank where nothing was measured"
        problem = "is not a finite number"
        if is_number(cell) and math.isfinite(float(cell)):
            problem, remedy = "is beyond any meaning", f"numbers are below {LARGEST:.0e}"
        raise self.error(f"{short(cell, 40)!r} {problem}", row=row, column=name, remedy=remedy)


def is_number(cell: str) -> bool:
    """Whether a cell is a plain decimal number; 'nan' and 'inf' are not told apart from one here."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell and cell.isascii()


def read(path: str | Path) -> Table:
    """Read a table: Parquet where the name ends with .parquet or .pq, else CSV.

    Raises:
        InputError: unreadable, empty, without rows, or not a well-formed table.
    """
    table = _read_parquet(Path(path)) if Path(path).suffix.lower() in PARQUET else _read_csv(Path(path))
    names = list(table.columns)
    for number, name in enumerate(names, 1):
        if not name:
            raise table.error(f"column {number} has no name", remedy="name every column, or delete the empty one")
    if not len(table):
        raise table.error("there is a header but no row", remedy="add one line per pose")
    return table


def write(
    path: str | Path, columns: Mapping[str, Sequence[str] | np.ndarray], metadata: Mapping[str, str] | None = None
) -> None:
    """Write a table atomically, as Parquet or CSV by the name's ending; NaN and '' become blank (null)."""
    if Path(path).suffix.lower() in PARQUET:
        _write_parquet(Path(path), columns, metadata or {})
        return
    text = io.StringIO(newline="")
    for key, value in (metadata or {}).items():
        text.write(f"# {key} = {' '.join(value.split())}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    cells = [_formatted(c) if isinstance(c, np.ndarray) else c for c in columns.values()]
    writer.writerows(zip(*cells, strict=True))
    files.write_text(path, text.getvalue())


def _formatted(values: np.ndarray) -> list[str]:
    if values.dtype.kind in "iub":
        return [str(int(v)) for v in values]
    # 15 digits: every decimal number that was read comes back as it was written.
    return ["" if math.isnan(v) else f"{v:.15g}" for v in values.tolist()]


def _read_csv(path: Path) -> Table:
    text = decoded(path)
    if text.startswith("PAR1"):
        raise InputError("this is a Parquet file", file=path, remedy="give it a name that ends with .parquet")
    stream = io.StringIO(text, newline="")
    metadata, metadata_lines, comments, first, above = _head(stream, path)
    if not first.strip():
        raise InputError("there is no header line", file=path, remedy="name the columns: q1_deg,q2_deg,q3_deg,x_mm,…")

    def body() -> Iterator[str]:
        yield first
        yield from stream

    # The csv module refuses fields beyond this length and broken quotes with an error of its own.
    separator = next((s for s in ";\t" if s in first and "," not in first), ",")
    reader = csv.reader(body(), delimiter=separator, strict=True)
    header: list[str] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        header = [name.strip() for name in next(reader)]
        top = above + reader.line_num
        width = len(header)
        for row in reader:
            if len(row) != width:
                if not "".join(row).strip() and len(row) <= 1:
                    continue
                _refuse_row(row, header, path, above + reader.line_num)
            rows.append(row)
            lines.append(above + reader.line_num)
    except csv.Error as error:
        raise InputError(
            f"not valid CSV: {error}", file=path, line=above + reader.line_num, remedy="check the quotes of this line"
        ) from None
    for number, name in enumerate(header):
        if name and name in header[:number]:
            raise InputError(f"column '{name}' is given twice", file=path, line=top, remedy="keep one of them")
    cells = zip(*rows, strict=True) if rows else [()] * width
    columns = {name: [cell.strip() for cell in column] for name, column in zip(header, cells, strict=True)}
    if separator != ",":  # then a comma is a decimal one
        columns = {name: [_point(cell) for cell in column] for name, column in columns.items()}
    return Table(str(path), columns, np.array(lines, int), metadata, metadata_lines, comments, top)


def decoded(path: Path) -> str:
    """The text of a table: UTF-8, or UTF-16 and Windows-1252 as spreadsheets save them.

    Raises:
        InputError: as :func:`pcalib.files.read_text`.
    """
    content = files.read_bytes(path)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            return content.decode("utf-16")
        except UnicodeDecodeError:
            pass
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        if not _CONTROL.search(content) and not content.startswith(b"PAR1"):
            return content.decode("cp1252", "replace")
    return files.read_text(path)


def _point(cell: str) -> str:
    """A number with a decimal comma as one with a point; any other text as it is."""
    return cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell


def _head(stream: io.StringIO, path: Path) -> tuple[dict[str, str], dict[str, int], dict[int, str], str, int]:
    """Metadata, the line of each key, comments by line, the header line and the number of lines above it."""
    metadata: dict[str, str] = {}
    lines: dict[str, int] = {}
    comments: dict[int, str] = {}
    for number, line in enumerate(stream, 1):
        bare = line.strip()
        if bare and not bare.startswith("#"):
            return metadata, lines, comments, line, number - 1
        key, equals, value = bare.lstrip("#").partition("=")
        key = key.strip()
        if equals:
            if key in metadata:
                raise InputError(f"metadata '{key}' is given twice", file=path, line=number, remedy="keep one of them")
            metadata[key], lines[key] = value.strip(), number
        elif key:
            comments[number] = key
    return metadata, lines, comments, "", 0


def _refuse_row(row: list[str], header: list[str], path: Path, line: int) -> NoReturn:
    remedy = "every row has one field per column; leave a field blank where nothing was measured"
    if row and row[0].lstrip().startswith("#"):
        remedy = "'#' lines stand above the header"
    elif len(row) == 1 and ";" in row[0]:
        remedy = "separate the fields with commas"
    elif len(row) > len(header):
        remedy += "; decimals are written with a point"
    raise InputError(f"{len(row)} fields where the header has {len(header)}", file=path, line=line, remedy=remedy)


def _read_parquet(path: Path) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    data = files.read_bytes(path)
    try:
        schema = pq.read_schema(pa.BufferReader(data))
        for name, kind in zip(schema.names, schema.types, strict=True):
            if pa.types.is_nested(kind):
                raise InputError(f"type {kind} cannot be used", file=path, column=name, remedy="store numbers or text")
        words = [n for n, kind in zip(schema.names, schema.types, strict=True) if not pa.types.is_primitive(kind)]
        file = pq.ParquetFile(pa.BufferReader(data), read_dictionary=words)
        rows = file.metadata.num_rows
        if rows * (len(schema.names) + 3 * len(words)) > MOST_CELLS:  # a text takes as much as four numbers
            raise InputError(
                f"{rows} rows of {len(schema.names)} columns are more than can be held", file=path,
                remedy=f"split the file: at most {MOST_CELLS} numbers are read",
            )  # fmt: skip
        content = file.read()
        content.validate(full=True)
        names = content.column_names
        metadata = {
            key.decode("utf-8", "replace"): value.decode("utf-8", "replace")
            for key, value in (content.schema.metadata or {}).items()
        }
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        first = (str(error).splitlines() or ["unknown error"])[0]
        problem = f"not a readable Parquet file: {first}"
        raise InputError(problem, file=path, remedy="write it anew, or use CSV") from None
    columns: dict[str, Sequence[str] | np.ndarray] = {}
    for name, column in zip(names, content.columns, strict=True):
        if name in columns:
            raise InputError(f"column '{name}' is given twice", file=path, remedy="keep one of them")
        columns[name] = _parquet_cells(path, name, column)
    # Writers leave notes of their own here (pandas, ARROW:schema, …): only lower-case words are taken for metadata.
    metadata = {key: value for key, value in metadata.items() if key.isidentifier() and key != "pandas"}
    return Table(str(path), columns, np.arange(1, content.num_rows + 1), metadata, {}, {})


def _parquet_cells(path: Path, name: str, column: pa.ChunkedArray) -> Sequence[str] | np.ndarray:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.types as t

    kind = column.type
    try:
        if t.is_dictionary(kind) and (t.is_string(kind.value_type) or t.is_large_string(kind.value_type)):
            cells: list[str] = []
            for chunk in column.chunks:  # equal cells share one text
                words = [(cell or "").strip() for cell in chunk.dictionary.to_pylist()]
                cells += ["" if i is None else words[i] for i in chunk.indices.to_pylist()]
            return cells
        if t.is_dictionary(kind):
            column, kind = column.cast(kind.value_type), kind.value_type
        if t.is_boolean(kind) or t.is_integer(kind) or t.is_floating(kind) or t.is_decimal(kind) or t.is_null(kind):
            floats = pc.cast(column, pa.float64(), safe=False)
            return np.array(floats.to_numpy(), float)
    except (pa.ArrowException, ValueError) as error:
        raise InputError(f"cannot be read: {error}", file=path, column=name) from None
    raise InputError(f"type {kind} cannot be used", file=path, column=name, remedy="store numbers or text")


def _write_parquet(path: Path, columns: Mapping[str, Sequence[str] | np.ndarray], metadata: Mapping[str, str]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = {
        name: pa.array(cells, from_pandas=True)
        if isinstance(cells, np.ndarray)
        else pa.array([cell or None for cell in cells], pa.string())
        for name, cells in columns.items()
    }
    table = pa.table(arrays).replace_schema_metadata(dict(metadata))
    with files.atomic(path) as temporary:
        pq.write_table(table, temporary)
