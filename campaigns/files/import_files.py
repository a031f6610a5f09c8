"""Imports recordings in the formats and dialects of laboratories with a guessed mapping.

A guess is right when every channel has its column, unit, sign and clock and nothing is asked; asked when what
is wrong or missing has a doubt or is named as lacking; wrong otherwise. Of a mutation the same is asked, or a
sentence: a wrong unit in silence, a traceback and a wrong column without a doubt are bad. Exit code 1 when a
guess is wrong or a mutation bad. `--only TASK --keep FOLDER` keeps the files of one task.
"""

from __future__ import annotations

import argparse
import random
import shutil
import tempfile
from argparse import Namespace
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np

from campaigns import ROOT
from campaigns.files import import_kinds, import_mutations
from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.dataset import read_dataset
from needle_rig.dataset.description import RigPart, read_description
from needle_rig.errors import BadInput
from needle_rig.importing import Mapping, dataset_of, guess, read_recording
from needle_rig.importing.unit_text import unit_of

PRACTICE = ROOT / "tests/data/practice/elastic"
SAMPLED_TO_S = 0.02
"""Offset between clocks: a sample of the practice recordings."""


@cache
def sources() -> list[import_kinds.Source]:
    """Trials of a practice dataset as recordings."""
    made = []
    for trial in read_dataset(PRACTICE).trials:
        known = np.isfinite(trial.base_measured_rad)
        made.append(
            import_kinds.Source(
                trial.trial.time_s[known],
                trial.base_measured_rad[known],
                trial.torque_nm[known],
                trial.hall_rad[known],
            )
        )
    return made


def faults(mapping: Mapping, truth: import_kinds.Truth) -> tuple[list[str], list[str]]:
    """What is wrong in silence, and what is wrong or missing and said."""
    silent, said = [], list(mapping.lacks()) + mapping.doubts()
    for role, (source, factor, sign) in truth.channels.items():
        channel = next((c for c in mapping.channels if c.role == role), None)
        if channel is None:
            silent.append(f"{role} is not there")
            continue
        # Two recordings' copies of one column are numbered; their place in the file tells them apart.
        clock = mapping.clocks[channel.clock]
        unit = unit_of(channel.unit or "")
        wrong = []
        # of several buses, as a damaged name makes, each message's channels are named with their bus
        of_bus = "." in source and channel.source.partition(" ")[2] == source
        if channel.source != source and not of_bus:
            wrong.append(f"{role} is {channel.source}, not {source}")
        if unit is not None and abs(unit.si * channel.scale / factor - 1.0) > 1e-6:
            wrong.append(f"{role} in {channel.unit}")
        if channel.sign != sign:
            wrong.append(f"{role} has the sign {channel.sign:+d}")
        if not channel.doubt and not any(role in lack for lack in mapping.lacks()):
            silent += wrong
        else:
            said += wrong
        for label, offset_s in truth.offset_s.items():
            if label in channel.clock and abs(clock.files[0].offset_s - offset_s) > SAMPLED_TO_S:
                (said if clock.doubt else silent).append(
                    f"clock {channel.clock} is {clock.files[0].offset_s:+g} s off"
                )
    base = next(c for c in mapping.channels if c.role == "base_angle")
    clock = mapping.clocks[base.clock]
    step_s = _step_s(mapping, base.clock, truth)
    if step_s is not None and not 0.99 < step_s / truth.step_s < 1.01:
        (said if clock.doubt else silent).append(f"steps of {step_s:g} s, not {truth.step_s:g} s")
    return silent, said


def _step_s(mapping: Mapping, name: str, truth: import_kinds.Truth) -> float | None:
    clock = mapping.clocks[name]
    if clock.rate_hz is not None:
        return 1.0 / clock.rate_hz
    unit = unit_of(clock.unit or "")
    if unit is None or clock.source is None:
        return None
    column = read_recording(Path(clock.files[0].path)).column(clock.source)
    return None if column is None else float(np.nanmedian(np.diff(column.values))) * unit.si


def judged(truth: import_kinds.Truth, rig: RigPart, folder: Path, imports: bool) -> tuple[str, str]:
    """right, asked, refused or wrong; and what was said."""
    try:
        mapping = guess([read_recording(file) for file in truth.files], "case", rig, Path())
    except BadInput as error:
        return "refused", str(error)
    silent, said = faults(mapping, truth)
    if silent:
        return ("wrong" if not said else "asked"), "; ".join([*silent, *said])
    if said:
        return "asked", "; ".join(said)
    if imports:
        try:
            dataset_of(mapping, Path())
        except BadInput as error:
            return "refused", str(error)
    return "right", ""


def plan(given: Namespace) -> list[Row]:
    """Every kind of file, then mutations of files drawn from all."""
    names, seed = list(import_kinds.CASES), given.first_seed
    drawn = random.Random(seed)
    mutations = [{"file": drawn.choice(names), "mutation": 10_000 * seed + k} for k in range(given.size)]
    return [*({"file": name} for name in names), *mutations]


def ask(task: Row, given: Namespace) -> Row:
    """What is guessed of one file."""
    name, kind = task["file"], ""
    source = sources()[list(import_kinds.CASES).index(name) % len(sources())]
    with tempfile.TemporaryDirectory(prefix="import_files-") as top:
        folder = Path(top) / name
        folder.mkdir()
        truth = import_kinds.CASES[name](source, folder)
        if "mutation" in task:
            kind, truth = import_mutations.mutated(truth, random.Random(task["mutation"]))
        if given.keep:
            shutil.copytree(folder, given.keep / name, dirs_exist_ok=True)
        verdict, said = judged(truth, read_description(PRACTICE)[0].rig, folder, imports=True)
    expected = kind != "" or verdict == ("asked" if truth.askable else "right")
    return {"kind": kind, "verdict": verdict, "said": said, "expected": expected}


def table(rows: list[Row], _: Namespace) -> str:
    """How guesses end, by file and by kind of mutation."""
    files = [row for row in answered(rows) if "mutation" not in row]
    mutations = Counter((row["kind"], row["verdict"]) for row in answered(rows) if "mutation" in row)
    guesses = []
    for row in files:
        mark = "" if row["expected"] else " ←"
        guesses.append((row["file"], row["verdict"] + mark, row["said"][:150].replace("|", "¦")))
    ends = Counter(row["verdict"] for row in files)
    sums = f"{len(files)} files: " + ", ".join(f"{n} {end}" for end, n in sorted(ends.items()))
    damaged = markdown(("mutation", "guess", "files"), ((*end, n) for end, n in sorted(mutations.items())))
    return "\n\n".join([markdown(("file", "guess", "said"), guesses), sums, damaged])


def failed(rows: list[Row]) -> bool:
    return any(row["verdict"] == "wrong" for row in answered(rows))


def options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(first_seed=1)
    parser.add_argument("--keep", type=Path, help="folder for the files of the task")


CAMPAIGN = Campaign(__doc__, plan, ask, table, 200, "mutations (200)", options, failed)
