"""Drawn pictures as files, and pages that hold everything they show: no other file, no script."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from needle_rig.figures.figure import Figure as Figure  # also for those who only name the type

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222;
       max-width: 76rem; margin: 2rem auto; padding: 0 1rem }
table { border-collapse: collapse; margin: 1rem 0; font-size: 14px }
th, td { padding: .3rem .8rem .3rem 0; border-bottom: 1px solid #ddd; vertical-align: top; text-align: left }
td.number { text-align: right; font-variant-numeric: tabular-nums }
tbody th { font-weight: 400 }
tr.no td.mark { color: #b3400a; font-weight: 600 }
tr.yes td.mark { color: #14713f; font-weight: 600 }
img { max-width: 100%; margin: .5rem 0 1rem }
"""


@dataclass(frozen=True)
class Picture:
    """A drawn picture."""

    name: str
    title: str
    png: bytes


def write_pngs(drawn: Sequence[Picture], folder: Path) -> list[Path]:
    """NAME.png of every picture in `folder`, which is made when missing."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for picture in drawn:
        path = folder / f"{picture.name}.png"
        path.write_bytes(picture.png)
        written.append(path)
    return written


def paragraph(text: str) -> str:
    """`text` as a paragraph."""
    return f"<p>{html.escape(text)}</p>"


def heading(text: str) -> str:
    """A heading within the page."""
    return f"<h2>{html.escape(text)}</h2>"


def items(title: str, texts: Iterable[str]) -> str:
    """A heading and a list; nothing when the list is empty."""
    rows = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
    return f"{heading(title)}<ul>{rows}</ul>" if rows else ""


def table(head: Sequence[str], rows: Iterable[str]) -> str:
    """A table of rows that are HTML already, see `row`."""
    titles = "".join(f"<th>{html.escape(title)}</th>" for title in head)
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def row(name: str, cells: Iterable[str | float], mark: bool | None = None) -> str:
    """One row: its name, then numbers to the right and words to the left; `mark` colours a yes or no."""
    told = [f"<th>{html.escape(name)}</th>"]
    for cell in cells:
        text = html.escape(cell) if isinstance(cell, str) else f"{cell + 0.0:.4g}"
        kind = "mark" if mark is not None and text in ("yes", "no") else ""
        kind = kind if isinstance(cell, str) else "number"
        told.append(f'<td class="{kind}">{text}</td>' if kind else f"<td>{text}</td>")
    tag = "tr" if mark is None else f'tr class="{"yes" if mark else "no"}"'
    return f"<{tag}>{''.join(told)}</tr>"


def shown(picture: Picture) -> str:
    """HTML of a picture under its title."""
    return f"{heading(picture.title)}{image(picture.title, picture.png)}"


def image(alt: str, png: bytes) -> str:
    """A picture that the page itself holds; `alt` says what it shows."""
    data = base64.b64encode(png).decode("ascii")
    return f'<img alt="{html.escape(alt)}" src="data:image/png;base64,{data}">'


def write_page(path: Path, title: str, blocks: Iterable[str]) -> None:
    """One file with `blocks`, each made by a function of this file."""
    named, body = html.escape(title), "\n".join(block for block in blocks if block)
    path.write_text(
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{named}</title>'
        f"<style>{_STYLE}</style>\n<h1>{named}</h1>\n{body}\n</html>\n",
        encoding="utf-8",
    )
