"""Docs, help texts and docstrings are in the field's words; a sentence of the docs is read in one go."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from needle_rig.cli.main import group

ROOT = Path(__file__).parents[2]
PAGES = [
    path
    for path in (*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md")
    if "evidence" not in path.parts
]
"""All but tables of results, which scripts write."""
WORDS = {
    r"foret(?:ell|old)\w*": "predict",
    r"bears? out|bore out": "support",
    r"what is left": "residual, or what remains",
    r"asked again": "run again",
    r"(?:is|are|was|were) told(?! (?:to|apart|that|what)\b)": "is reported, is given, is known",
}
"""Words to avoid, each with the field's own. *Told apart* and *told to stop* are fine."""
MOST_WORDS = 25


def found(text: str) -> list[str]:
    """Words to avoid in a text, each with the one to use."""
    return [
        f"{hit[0]!r}: {instead}"
        for words, instead in WORDS.items()
        for hit in re.finditer(rf"\b(?:{words})\b", re.sub(r"\s+", " ", text))
    ]


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Every string that stands by itself, with its line: of modules, classes, functions and attributes."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield node.lineno, node.value.value


def help_texts(command: click.Command, name: str) -> Iterator[tuple[str, str]]:
    """Of a command, its options and all below it."""
    yield name, command.get_help(click.Context(command))
    if isinstance(command, click.Group):
        context = click.Context(command)
        for word in command.list_commands(context):
            below = command.get_command(context, word)
            assert below is not None
            yield from help_texts(below, f"{name} {word}")


def prose(page: str) -> Iterator[str]:
    """Paragraphs and items of lists, without code, tables, pictures and headings."""
    page = re.sub(r"^( *)(```+).*?^\1\2[^\n]*$", "", page, flags=re.DOTALL | re.MULTILINE)
    page = re.sub(r"<!--.*?-->", "", page, flags=re.DOTALL)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*+]|\d+\.)\s)", page):
        lines = [line for line in block.splitlines() if line.strip()]
        if all(line.startswith("    ") for line in lines) or lines[0].lstrip().startswith(
            ("|", "#", "<", ":::")
        ):
            continue
        text = re.sub(r"`[^`]*`", "code", " ".join(lines)).replace("*", "")
        text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
        yield re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)


def sentences(page: str) -> Iterator[str]:
    """A colon and a semicolon end one, as a full stop does."""
    for text in prose(page):
        yield from re.split(r"(?<=[.!?:;])\s+", " ".join(text.split()))


def too_long(page: str) -> list[str]:
    """Sentences of too many words; a number with its unit is two, a word with hyphens one."""
    return [s for s in sentences(page) if len(re.findall(r"\w[\w'’.,/-]*", s)) > MOST_WORDS]


def test_docs_have_the_words_of_the_field() -> None:
    texts = {str(page.relative_to(ROOT)): page.read_text(encoding="utf-8") for page in PAGES}
    assert not {name: found(text) for name, text in texts.items() if found(text)}


def test_docstrings_have_the_words_of_the_field() -> None:
    assert not {
        f"{path.relative_to(ROOT)}:{line}": found(text)
        for path in sorted((ROOT / "needle_rig").rglob("*.py"))
        for line, text in docstrings(path)
        if found(text)
    }


def test_help_texts_have_the_words_of_the_field() -> None:
    texts = dict(help_texts(group, "needle-rig"))
    assert len(texts) > 30
    assert not {name: found(text) for name, text in texts.items() if found(text)}


def test_sentences_of_the_docs_are_short() -> None:
    pages = {str(page.relative_to(ROOT)): too_long(page.read_text(encoding="utf-8")) for page in PAGES}
    assert not {name: long for name, long in pages.items() if long}


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("The model foretells what is left; asked again, it bears\nout all that is told.", 5),
        ("The drive is told to stop. Two effects cannot be told apart. The model predicts the residual.", 0),
    ],
)
def test_the_vocabulary_finds_its_words(text: str, count: int) -> None:
    assert len(found(text)) == count


@pytest.mark.parametrize(
    ("page", "count"),
    [
        ("word " * MOST_WORDS + "end.", 1),
        ("word " * (MOST_WORDS - 1) + "end.\n\n- " + "word " * (MOST_WORDS - 1) + "end.", 0),
        ("```\n" + "word " * 60 + "\n```\n\n| " + "word " * 60 + "|\n\n    " + "word " * 60, 0),
        ("**Bold.** " + "word " * (MOST_WORDS - 1) + "`some code of many words`", 0),
        ("![" + "word " * 60 + "](a.png) and [" + "word " * 26 + "](b.md)", 1),
    ],
)
def test_a_sentence_is_what_a_person_reads_in_one_go(page: str, count: int) -> None:
    assert len(too_long(page)) == count
