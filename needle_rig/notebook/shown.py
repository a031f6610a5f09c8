"""What every result can do: a headline, a table, a picture, and all of it in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from needle_rig.errors import BadInput
from needle_rig.notebook.tables import Table, frame

if TYPE_CHECKING:
    from pandas import DataFrame

    from needle_rig.figures.page import Figure

MOST_ROWS = 20
"""Rows of a table that a notebook shows; `table` has them all."""


class Shown:
    """A result with a headline, a table and a picture."""

    def headline(self) -> str:
        """What it says, in one sentence."""
        raise NotImplementedError

    def table(self) -> Table:
        """Its numbers, one row each."""
        raise NotImplementedError

    def to_pandas(self) -> DataFrame:
        """Its table as a pandas DataFrame. Raises BadInput where pandas is not installed."""
        return frame(self.table())

    def plot(self) -> Figure:
        """Its picture."""
        raise BadInput(f"{type(self).__name__} has no picture; look at its table")

    def __repr__(self) -> str:
        return self.headline()

    def _repr_html_(self) -> str:
        # the picture stands in the HTML: a notebook shows one form of a result, and takes this one first
        from needle_rig.figures import page
        from needle_rig.figures.figure import png

        rows = self._overview()
        body = [
            page.row(str(each[0]), [_cell(value) for value in list(each)[1:]])
            for each in rows[:MOST_ROWS].tolist()
        ]
        left_out = len(rows) - MOST_ROWS
        more = page.paragraph(f"{left_out} rows more in table()") if left_out > 0 else ""
        try:
            picture = page.image(self.headline(), png(self.plot()))
        except BadInput:  # it has none
            picture = ""
        return page.paragraph(self.headline()) + page.table(rows.dtype.names or (), body) + more + picture

    def _overview(self) -> Table:
        """The table that a notebook shows."""
        return self.table()


def _cell(value: Any) -> str | float:
    return value if isinstance(value, str) else float(value)
