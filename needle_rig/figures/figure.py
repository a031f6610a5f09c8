"""The figure that all pictures are drawn on: Matplotlib's, which shows itself in a notebook."""

from __future__ import annotations

import io
import sys

from matplotlib import figure

from needle_rig.errors import BadInput

FORMATS = (".png", ".svg", ".pdf")
"""Endings of what every figure can be written as."""


class Figure(figure.Figure):
    """Matplotlib's figure, without pyplot: no window belongs to it."""

    def show(self, warn: bool = True) -> None:  # noqa: ARG002 Matplotlib's signature
        """Show it below the cell of a notebook. Raises BadInput elsewhere."""
        if "ipykernel" not in sys.modules:
            raise BadInput(
                'a figure is shown in a notebook alone; write it to a file: figure.savefig("figure.png")'
            )
        from IPython.display import display

        display(self)  # type: ignore[no-untyped-call]

    def _repr_png_(self) -> bytes:
        # pyplot alone would teach this to a notebook, and is not used
        return png(self)


def png(figure: Figure, dpi: int = 110) -> bytes:
    """A figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()
