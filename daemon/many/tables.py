"""Rows of many units as a Parquet file: the only file that knows PyArrow.

Parquet is what pandas, polars, DuckDB, R and MATLAB read without a word about types or units; its
columns are small and one can be read without the others.
"""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from steerd.daemon.common.notebook import make_frame
from steerd.daemon.common.written import check_outputs, write_outputs

if TYPE_CHECKING:
    import pandas

Kind = Literal["number", "count", "text", "truth"]
_TYPES = {"number": "float64", "count": "int64", "text": "string", "truth": "bool"}


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        name: of the column.
        kind: of its values; each may be missing.
        unit: SI, `1` for none; empty where it is no number.
        meaning: one line.
    """

    name: str
    kind: Kind
    unit: str
    meaning: str


def save_table(path: Path | str, content: bytes) -> Path:
    """Write a table, whole or not at all; its path.

    Raises:
        SteerdError: it cannot be written there.
    """
    path = Path(path)
    check_outputs({"save_table": path})
    write_outputs({path: content})
    return path


def frame_of(columns: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> "pandas.DataFrame":
    """The rows as a data frame with its units."""
    values = {c.name: [row.get(c.name) for row in rows] for c in columns}
    return make_frame(values, {c.name: c.unit for c in columns})


def encode_table(
    columns: Sequence[Column], rows: Sequence[Mapping[str, Any]], about: Mapping[str, str]
) -> bytes:
    """A Parquet file; the same rows give the same bytes.

    Args:
        columns: in the table's order, units and meanings go into the file.
        rows: values by column's name; what is absent, None or NaN is missing.
        about: texts that say where the table comes from.
    """
    import pyarrow as pa  # noqa: TID251
    from pyarrow import parquet  # noqa: TID251

    fields, values = [], []
    for column in columns:
        kind = _TYPES[column.kind]
        note = {"unit": column.unit, "meaning": column.meaning}
        fields.append(pa.field(column.name, kind, metadata=note))
        values.append(pa.array([_value(row.get(column.name)) for row in rows], kind))
    schema = pa.schema(fields, metadata=dict(about))
    out = io.BytesIO()
    parquet.write_table(pa.table(values, schema=schema), out, compression="zstd")
    return out.getvalue()


def _value(value: Any) -> Any:
    return None if isinstance(value, float) and value != value else value
