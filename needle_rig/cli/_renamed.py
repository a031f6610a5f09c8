"""Old spellings of options whose meaning differed from command to command: they work, with a warning line."""

from __future__ import annotations

from dataclasses import dataclass

import click


@dataclass(frozen=True)
class Renamed:
    """`old` of `command` is `new` now, but for the values of `kept`."""

    command: str
    old: str
    new: str
    kept: tuple[str, ...] = ()


RENAMED = (
    Renamed("calibrate", "--rig", "--config", kept=("bench",)),
    Renamed("compare", "--png", "--pictures"),
    Renamed("demo", "--model-out", "--out"),
    Renamed("demo", "--png", "--pictures"),
    Renamed("experiment", "--rig", "--config"),
    Renamed("export", "--png", "--picture"),
    Renamed("reproduce", "--png", "--pictures"),
    Renamed("strategies", "--png", "--pictures"),
)


def in_new_words(command: str, arguments: list[str]) -> list[str]:
    """`arguments` of `command` with new spellings, after a warning for each old one."""
    words = list(arguments)
    options = words[: words.index("--")] if "--" in words else words
    for change in (each for each in RENAMED if each.command == command):
        for place, word in enumerate(options):
            name, equals, value = word.partition("=")
            value = value if equals else next(iter(words[place + 1 :]), "")
            if name == change.old and value not in change.kept:
                click.echo(f"warning: {change.old} of {command} is called {change.new} now", err=True)
                words[place] = change.new + equals + (value if equals else "")
    return words
