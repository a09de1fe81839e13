"""Tables: named columns of equal length."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


#: Rows of a table that a notebook shows.
_SHOWN = 20


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return escape(f"{value:.6g}" if isinstance(value, float) else str(value))


class Table:
    """Named columns of equal length; a missing value is `None`."""

    def __init__(self, columns: Mapping[str, Sequence[Any]]) -> None:
        self._columns = {name: list(values) for name, values in columns.items()}
        lengths = {len(values) for values in self._columns.values()}
        if len(lengths) > 1:
            raise ValueError("the columns of a table have one length")

    @property
    def columns(self) -> list[str]:
        """The names of the columns, in order."""
        return list(self._columns)

    def __len__(self) -> int:
        return len(next(iter(self._columns.values()), []))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column as an array. Missing numbers are NaN, so that a column with any is one of floats."""
        values = self._columns[name]
        if any(value is None for value in values) and all(
            value is None or isinstance(value, (int, float)) for value in values
        ):
            return np.array([np.nan if value is None else value for value in values], dtype=float)
        return np.array(values)

    def to_dict(self) -> dict[str, list[Any]]:
        """The columns as lists."""
        return {name: list(values) for name, values in self._columns.items()}

    def to_pandas(self) -> pd.DataFrame:
        """The table as a pandas data frame; needs pandas. Missing numbers stay missing, and whole numbers whole."""
        import pandas as pd

        frame = pd.DataFrame(self._columns)
        return frame.convert_dtypes(convert_string=False, convert_floating=False)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """The table for programs that read Arrow; needs pyarrow."""
        import pyarrow as pa

        return pa.table(self._columns).__arrow_c_stream__(requested_schema)

    def _repr_html_(self) -> str:
        """The table in a notebook: its first rows."""
        head = "".join(f"<th>{escape(name)}</th>" for name in self.columns)
        shown = list(zip(*(values[:_SHOWN] for values in self._columns.values())))
        rows = "".join("<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row) + "</tr>" for row in shown)
        more = len(self) - len(shown)
        note = f"<p>and {more:,} more rows</p>" if more > 0 else ""
        return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{note}"

    def __repr__(self) -> str:
        return f"<Table of {len(self)} rows: {', '.join(self.columns)}>"
