"""Imports recordings in the formats and dialects of laboratories with a guessed mapping, and holds it
against the truth.

import_files                          66 files and 200 mutations of them, some minutes of one core
import_files --only labview --mutations 0
import_files --share 0.2 --seed 3     a part of it

A guess is right when every channel has its column, unit, sign and clock and nothing is asked; asked when what
is wrong or missing has a doubt or is named as lacking; wrong otherwise. Of a mutation the same is asked, or a
sentence: a wrong unit in silence, a traceback and a wrong column without a doubt are bad. The exit code is 1
when a guess is wrong or a mutation bad.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from campaigns import ROOT
from campaigns.files import import_kinds, import_mutations
from needle_rig.dataset import read_dataset
from needle_rig.dataset.description import RigPart, read_description
from needle_rig.errors import BadInput
from needle_rig.importing import Mapping, dataset_of, guess, read_recording
from needle_rig.importing.unit_text import unit_of

PRACTICE = ROOT / "tests/data/practice/elastic"
SAMPLED_TO_S = 0.02
"""Offset between clocks: a sample of the practice recordings."""


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
        if channel.source != source:
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


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="part of a case's name")
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--mutations", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for the files of bad mutations")
    arguments = parser.parse_args()
    chosen = [name for name in import_kinds.CASES if arguments.only in name]
    random.seed(arguments.seed)
    if arguments.share < 1.0:
        chosen = sorted(random.sample(chosen, max(1, round(arguments.share * len(chosen)))), key=chosen.index)
    rig = read_description(PRACTICE)[0].rig
    recordings = sources()
    ends: Counter[str] = Counter()
    bad = 0
    print(f"{'file':32s}  {'guess':8s}  {'s':>5s}  said")
    truths = {}
    with tempfile.TemporaryDirectory(prefix="import_files-") as top:
        for name in chosen:
            folder = Path(top) / name
            folder.mkdir()
            source = recordings[list(import_kinds.CASES).index(name) % len(recordings)]
            truth = truths[name] = import_kinds.CASES[name](source, folder)
            began = time.monotonic()
            end, said = judged(truth, rig, folder, imports=True)
            ends[end] += 1
            expected = ("asked",) if truth.askable else ("right",)
            mark = "" if end in expected else "  ←"
            bad += end == "wrong"
            print(f"{name:32s}  {end:8s}  {time.monotonic() - began:5.2f}  {said[:150]}{mark}")
        print(f"{len(chosen)} files: " + ", ".join(f"{n} {e}" for e, n in sorted(ends.items())))
        ends.clear()
        for k in range(round(arguments.mutations * arguments.share)):
            name = random.choice(chosen)
            folder = Path(top) / f"mutation-{k}"
            shutil.copytree(Path(top) / name, folder)
            truth = import_mutations.moved(truths[name], Path(top) / name, folder)
            kind, truth = import_mutations.mutated(truth, random.Random(arguments.seed * 10_000 + k))
            try:
                end, said = judged(truth, rig, folder, imports=True)
            except Exception as error:  # noqa: BLE001 - what the campaign looks for
                end, said = "crash", f"{type(error).__name__}: {error}"
            ends[f"{kind}: {end}"] += 1
            if end in ("wrong", "crash"):
                bad += 1
                print(f"BAD {name}, {kind}: {end}: {said[:300]}")
                if arguments.keep:
                    shutil.copytree(folder, arguments.keep / f"{k}-{name}", dirs_exist_ok=True)
            shutil.rmtree(folder)
        for end, count in sorted(ends.items()):
            print(f"  {count:4d}  {end}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
