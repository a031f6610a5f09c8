"""What a person may have done wrong in a file that is no YAML: indentation, colons, decimal commas, tabs."""

from __future__ import annotations

import re

SEEN_LETTERS = 60
"""Of a line that is no YAML, repeated in the error."""
_KEYED = re.compile(r"(?P<key>[^\s#'\"][^:]*):\s+(?P<value>[^\s#].*?)\s*")
_WHOLE = re.compile(r"[-+]?[0-9]+")


def sentence(problem: str, text: str, place: tuple[int, int], opened: int | None) -> str:
    """What is wrong at `place` (line and column from 0) of `text`, for which YAML's reader says `problem`.

    `opened` is the line (from 0) where what it was reading began.
    """
    number, column = place
    lines = text.splitlines()
    line = lines[number] if number < len(lines) else ""
    if "\t" in line[: column + 1] or "'\\t'" in problem:
        return "a tab stands where YAML wants spaces; indent with spaces"
    if "undefined alias" in problem:
        return f"{problem}; text that starts with * needs quotes"
    if "another document" in problem:
        return "a second document begins; keep one document a file"
    if problem.startswith("mapping values"):
        meant = _colon(lines, number, column)
        if meant:
            return meant
    if problem.startswith("expected <block end>") and not line[:column].strip():
        return f"the line is indented by {_spaces(column)}, as no line above it; align it with its section"
    problem = problem.replace("could not find expected ':'", "a ':' is missing")
    near = line[max(0, column - SEEN_LETTERS) :].strip()[: 2 * SEEN_LETTERS]
    seen = f" in {near!r}" if near else " at the end of the file"
    since = f" (opened at line {opened + 1})" if opened is not None and opened != number else ""
    return f"is not YAML: {problem}{seen}{since}; check quotes, brackets, colons and indentation"


def decimal_comma(before: str, after: str) -> str:
    """What to write where `before`,`after` stand in braces without a space; empty when that is no number."""
    if _WHOLE.fullmatch(before) and after.isascii() and after.isdigit():
        return f"a comma separates entries here; write {before}.{after}"
    return ""


def _colon(lines: list[str], number: int, column: int) -> str:
    """Of a colon where YAML wants none: the line is indented too far, or its text needs quotes."""
    line = lines[number]
    indented = len(line) - len(line.lstrip())
    if ": " not in line[indented:column] + " ":
        above = next((other for other in reversed(lines[:number]) if _content(other)), "")
        wanted = len(above) - len(above.lstrip(" -"))
        if above and indented > wanted:
            return (
                f"the line is indented by {_spaces(indented)}, more than the line above, which has a value"
                f" already; indent it by {wanted}, or take that value away"
            )
        return ""
    keyed = _KEYED.fullmatch(line.split(" #")[0].strip().removeprefix("- "))
    if keyed is None or '"' in keyed["value"]:
        return ""
    return f'text with a colon and a space needs quotes; write {keyed["key"]}: "{keyed["value"]}"'


def _content(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _spaces(count: int) -> str:
    return f"{count} space{'' if count == 1 else 's'}"
