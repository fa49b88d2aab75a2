"""Tables and matrices that results are."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ._abbe import Columns

Column = NDArray[Any]


class Table:
    """Columns by name: numbers as arrays of NumPy, texts as arrays of objects. Names carry units: `x_mm`, `error_x_um`.

    `polars.DataFrame(table)`, `pyarrow.table(table)` and `pandas.DataFrame.from_arrow(table)` take it by Arrow's
    interface (`__arrow_c_stream__`), without a copy; `dict(table)` is a dict of arrays, which
    `pandas.DataFrame(dict(table))` takes.

    >>> import abbe
    >>> run = abbe.run("pipelines/first-steps.yaml")
    >>> parameters = run.fits["fit"].parameters
    >>> list(parameters)
    ['name', 'value', 'unit', 'standard_uncertainty', 'status']
    >>> parameters["name"][:3]
    array(['dxt', 'dyt', 'dzt'], dtype=object)
    >>> parameters["value"].dtype
    dtype('float64')
    """

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._names: list[str] = columns.names
        self._read: dict[str, Column] = {}

    def __getitem__(self, name: str) -> Column:
        if name not in self._read:
            kind = self._columns.kind(name)
            if kind == "text":
                self._read[name] = np.array(self._columns.texts(name), dtype=object)
            else:
                self._read[name] = np.frombuffer(self._columns.bytes(name), dtype=kind)
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def keys(self) -> list[str]:
        """Names of the columns."""
        return list(self._names)

    def items(self) -> Iterator[tuple[str, Column]]:
        """Names with their columns."""
        return ((name, self[name]) for name in self)

    def __len__(self) -> int:
        return len(self._names)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self._columns)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self._columns.__arrow_c_stream__(requested_schema)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """A structured array, with a field for each column."""
        if copy is False:
            raise ValueError("the columns of a table do not lie in one array: a copy is needed")
        array = np.empty(self.rows, dtype=[(name, self[name].dtype) for name in self])
        for name in self:
            array[name] = self[name]
        return array if dtype is None else array.astype(dtype)

    def numbers(self, *names: str) -> NDArray[np.float64]:
        """Some columns of numbers beside each other: rows x names."""
        return np.column_stack([self[name] for name in names]).astype(np.float64, copy=False)

    def _cells(self, most: int) -> list[list[str]]:
        def shown(value: Any) -> str:
            if value is None:
                return ""
            return f"{value:.6g}" if isinstance(value, float) else str(value)

        return [[shown(self[name][row]) for name in self] for row in range(min(self.rows, most))]

    def __repr__(self) -> str:
        lines = [list(self), *self._cells(20)]
        widths = [max(len(line[place]) for line in lines) for place in range(len(self))]
        text = "\n".join("  ".join(cell.rjust(width) for cell, width in zip(line, widths)) for line in lines)
        return text if self.rows <= 20 else f"{text}\n... {self.rows} rows"

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{html.escape(name)}</th>" for name in self)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in line) + "</tr>" for line in self._cells(60)
        )
        more = f"<p>{self.rows} rows</p>" if self.rows > 60 else ""
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


class Covariance:
    """A covariance matrix whose rows and columns have names; in the units of the values, squared.

    >>> import abbe
    >>> covariance = abbe.run("pipelines/first-steps.yaml").fits["fit"].covariance
    >>> covariance.names[:3]
    ('dxt', 'dyt', 'dzt')
    >>> covariance.array.shape == (len(covariance.names),) * 2
    True
    >>> round(float(covariance.correlation("EA0B", "EA0B")), 12)
    1.0
    """

    names: tuple[str, ...]
    """Names, in the order of rows and columns."""
    array: NDArray[np.float64]
    """The symmetric matrix."""

    def __init__(self, names: Sequence[str], array: NDArray[np.float64]) -> None:
        self.names, self.array = tuple(names), array

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.array, dtype=dtype, copy=copy)

    def _place(self, name: str) -> int:
        if name not in self.names:
            raise KeyError(f"`{name}` has no covariance")
        return self.names.index(name)

    def block(self, names: Sequence[str]) -> Covariance:
        """The covariance of some values, in this order."""
        places = [self._place(name) for name in names]
        return Covariance(names, self.array[np.ix_(places, places)])

    def correlation(self, one: str, other: str) -> float:
        """The correlation of two values, from -1 to 1."""
        row, column = self._place(one), self._place(other)
        scale = np.sqrt(self.array[row, row] * self.array[column, column])
        return float(self.array[row, column] / scale)

    def __repr__(self) -> str:
        return f"<Covariance of {len(self.names)} values: {', '.join(self.names[:6])}{', ...' * (len(self.names) > 6)}>"
