"""The glossary of the documentation as a page beside the page, so that its words are a click away."""

from __future__ import annotations

import html
import re
from pathlib import Path

from needle_rig.web.static_files import place

_HERE = Path(__file__).parent

_PLACES = (_HERE / "glossary.md", _HERE.parents[1] / "docs" / "glossary.md")
"""In a wheel, and in a clone."""


def glossary_html() -> str:
    """Headings, paragraphs and inline code of the glossary; links become their text."""
    text = next(path for path in _PLACES if path.is_file()).read_text(encoding="utf-8")
    parts = []
    for block in re.split(r"\n\s*\n|(?<=\n)(?=#)|(?<=^)(?=#)", text):
        for heading, lines in _split(block.strip()):
            if heading:
                level, words = heading
                parts.append(f'<h{level} id="{_anchor(words)}">{_inline(words)}</h{level}>')
            if lines:
                parts.append(f"<p>{_inline(lines)}</p>")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Glossary · needle-rig</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="stylesheet" href="{place()[1:]}/style.css"></head><body><main>'
        '<p><a href="./">Back to the page</a></p>' + "\n".join(parts) + "</main></body></html>"
    )


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
    shown = re.sub(r"`([^`]+)`", r"<code>\1</code>", shown)
    return re.sub(r"\*([^*]+)\*", r"<em>\1</em>", shown)
