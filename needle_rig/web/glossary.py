"""The glossary of the documentation as a page beside the page, so that its words are a click away."""

from __future__ import annotations

import html
import re
from pathlib import Path

from needle_rig.web.static_files import place

_HERE = Path(__file__).parent

CHAPTER = 2
"""Level of the headings that part it."""
_PLACES = (_HERE / "glossary.md", _HERE.parents[1] / "docs" / "glossary.md")
"""In a wheel, and in a clone."""


def glossary_html() -> str:
    """The glossary with a list of its parts; links become their text."""
    text = next(path for path in _PLACES if path.is_file()).read_text(encoding="utf-8")
    parts, chapters = [], []
    for block in re.split(r"\n\s*\n|(?<=\n)(?=#)|(?<=^)(?=#)", text):
        for heading, lines in _split(block.strip()):
            if heading:
                level, words = heading
                if level == CHAPTER:
                    chapters.append(f'<a href="#{_anchor(words)}">{_inline(words)}</a>')
                parts.append(f'<h{level} id="{_anchor(words)}">{_inline(words)}</h{level}>')
            if lines:
                parts.append(_table(lines) if lines.startswith("|") else f"<p>{_inline(lines)}</p>")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Glossary · needle-rig</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="stylesheet" href="{place()[1:]}/style.css"></head>'
        '<body><main class="glossary"><p><a href="./">Back to the page</a></p>'
        f'<nav aria-label="Parts">{"".join(chapters)}</nav>' + "\n".join(parts) + "</main></body></html>"
    )


def _table(lines: str) -> str:
    head, _, *rows = (
        [_inline(cell.strip()) for cell in row.strip("| ").split("|")] for row in lines.splitlines()
    )
    heads = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"


def _split(block: str) -> list[tuple[tuple[int, str] | None, str]]:
    found = re.match(r"(#{1,4}) (.*)\n?", block)
    if found is None:
        return [(None, block)]
    return [((len(found[1]), found[2]), block[found.end() :].strip())]


def _anchor(words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-")


def _inline(text: str) -> str:
    shown = html.escape(text)
    shown = re.sub(r"\[([^\]]+)\]\([^)]*\)", r"\1", shown)
    shown = re.sub(r"([θτ])_(\w+)", r"\1<sub>\2</sub>", shown)
    shown = re.sub(r"`([^`]+)`", r"<code>\1</code>", shown)
    return re.sub(r"\*([^*]+)\*", r"<em>\1</em>", shown)
