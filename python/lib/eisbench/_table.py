"""Tables: columns that any data frame library takes without copies (Arrow PyCapsule interface)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Optional, Union, cast

import numpy as np
from numpy.typing import NDArray

from ._eisbench import EisError
from ._optional import optional

Column = Union[NDArray[Any], list[Optional[str]]]


class Table(Mapping[str, Any]):
    """Columns of one length, in order.

    Numbers are NumPy arrays, missing ones not a number; texts are lists with None where missing.
    ``polars.DataFrame(table)``, ``pyarrow.table(table)`` and DuckDB take it by
    ``__arrow_c_stream__``, numbers without a copy; :meth:`to_pandas` gives a pandas data frame.
    """

    def __init__(self, columns: Mapping[str, Column]) -> None:
        self._columns: dict[str, Column] = dict(columns)
        lengths = {len(column) for column in self._columns.values()}
        if len(lengths) > 1:
            raise EisError(f"table: expected columns of one length, met {sorted(lengths)}")
        self._rows = lengths.pop() if lengths else 0

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(self._columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self._rows

    def __getitem__(self, key: str) -> Any:
        return self._columns[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def to_pandas(self) -> Any:
        """A pandas data frame."""
        import pandas

        return pandas.DataFrame(self._columns)

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """The table as an Arrow stream of one batch; missing numbers and texts are null."""
        nanoarrow: Any = _nanoarrow()
        arrays = [_arrow(nanoarrow, column) for column in self._columns.values()]
        fields = zip(self._columns, arrays)
        schema = nanoarrow.struct({name: array.schema for name, array in fields})
        whole = nanoarrow.c_array_from_buffers(schema, self._rows, [None], children=arrays)
        return nanoarrow.c_array_stream(whole).__arrow_c_stream__(requested_schema)

    def __repr__(self) -> str:
        return f"<Table: {self._rows} rows, {len(self._columns)} columns>"

    def __str__(self) -> str:
        from ._results import text_table

        rows = [[_cell(self[name][row]) for name in self] for row in range(min(self._rows, 10))]
        more = f"\n… {self._rows} rows" if self._rows > 10 else ""
        return text_table(self.columns, rows) + more

    def _repr_html_(self) -> str:
        from ._results import html_table

        rows = [[_cell(self[name][row]) for name in self] for row in range(min(self._rows, 50))]
        return html_table(f"{self._rows} rows", self.columns, rows)


def _cell(value: Any) -> str:
    from ._results import significant

    if value is None or value == "" or value != value:
        return "–"
    return str(value) if isinstance(value, (str, int)) else significant(float(value), 4)


def _nanoarrow() -> Any:
    try:
        import nanoarrow
    except ImportError:
        raise ImportError(
            "expected the package nanoarrow, which hands tables over: pip install 'eisbench[table]'"
        ) from None
    return nanoarrow


def _arrow(nanoarrow: Any, column: Column) -> Any:
    """A column as an Arrow array."""
    if isinstance(column, list):
        return nanoarrow.c_array(column, nanoarrow.string())
    values: Any = np.ascontiguousarray(column)
    if values.dtype.kind == "f":
        known = ~np.isnan(values)
        mask = None if bool(known.all()) else np.packbits(known, bitorder="little")
        kind = nanoarrow.float64()
        return nanoarrow.c_array_from_buffers(kind, len(values), [mask, values])
    if values.dtype.kind == "b":
        bits = np.packbits(values, bitorder="little")
        return nanoarrow.c_array_from_buffers(nanoarrow.bool_(), len(values), [None, bits])
    return nanoarrow.c_array_from_buffers(nanoarrow.int64(), len(values), [None, values])


def frame(columns: Mapping[str, Column]) -> Any:
    """Columns as a pandas data frame, with a time in UTC beside each ``…_unix_s``; a :class:`Table`
    where pandas is not installed."""
    try:
        pandas = optional("pandas", "'eisbench[table]'")
    except ImportError:
        return Table(columns)
    series: dict[str, Any] = {}
    for name, values in columns.items():
        # One kind for texts, also where all of them are missing.
        is_text = isinstance(values, list)
        series[name] = pandas.Series(values, dtype=object) if is_text else values
        if name.endswith("_unix_s"):
            time = name.removesuffix("_unix_s")
            series[time] = pandas.to_datetime(np.asarray(values), unit="s", utc=True)
    return pandas.DataFrame(series)


def columns_of(table: Any, wanted: Sequence[str]) -> dict[str, Any]:
    """The wanted columns that a table has: of a mapping, a data frame, or anything with
    ``__arrow_c_stream__`` or ``__arrow_c_array__``."""
    given: Any = table
    if not hasattr(given, "columns") and not hasattr(given, "keys"):
        given = _of_arrow(given)
    labels: Any = getattr(given, "column_names", getattr(given, "columns", given))
    names = [str(name) for name in labels]
    return {name: given[name] for name in wanted if name in names}


def _of_arrow(table: Any) -> Any:
    if not hasattr(table, "__arrow_c_stream__") and not hasattr(table, "__arrow_c_array__"):
        kind = type(table).__name__
        raise EisError(f"table: expected columns or an Arrow table, met {kind}")
    nanoarrow: Any = _nanoarrow()
    array = nanoarrow.Array(table)
    names = [field.name for field in array.schema.fields]
    return {name: array.child(k) for k, name in enumerate(names)}


def numbers(name: str, column: Any) -> NDArray[np.float64]:
    """A column of numbers; missing ones are not a number."""
    try:
        if hasattr(column, "to_numpy"):
            column = column.to_numpy()
        elif hasattr(column, "to_pylist"):
            column = [np.nan if value is None else value for value in column.to_pylist()]
        return np.ascontiguousarray(column, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise EisError(f"table: expected numbers in column {name}: {error}") from None


def names_of(column: Any) -> NDArray[Any]:
    """A column of names, as texts."""
    if hasattr(column, "to_pylist"):
        column = column.to_pylist()
    elif hasattr(column, "to_numpy"):
        column = column.to_numpy()
    values = np.asarray(column)
    if values.dtype.kind == "O":
        if any(value is None or value != value for value in cast("list[Any]", values.tolist())):
            raise EisError("table: expected a spectrum_id in every row, met none")
        values = np.asarray([str(value) for value in cast("list[Any]", values.tolist())])
    return values
