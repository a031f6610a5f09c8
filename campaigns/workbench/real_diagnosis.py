"""What the workbench says by itself of the real recordings, and how long one core takes for it.

`--only '{"command": "diagnose --max-effects 6"}'` asks for most of an hour.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from argparse import Namespace
from pathlib import Path
from typing import Any

from campaigns import ROOT
from campaigns.run import Campaign, Row, answered, markdown

RECORDED = ROOT / "config/recordings/davinci.yaml"
EFFECTS = ROOT / "config/recordings/effects"
COMMANDS = ("compare", "diagnose --quick", "diagnose")


def answer(*arguments: str) -> tuple[dict[str, Any], float]:
    """The JSON answer of a command and its processor time, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "needle_rig", *arguments]
    told = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return json.loads(told.stdout) if "--json" in arguments else {}, after.ru_utime - before.ru_utime


def plan(_: Namespace) -> list[Row]:
    return [{"command": command} for command in COMMANDS]


def ask(task: Row, _: Namespace) -> Row:
    """What one command says, and the processor time that it takes."""
    name, *options = task["command"].split()
    if name == "diagnose":
        options += ["--effects", str(EFFECTS), "--jobs", "1"]
    with tempfile.TemporaryDirectory() as folder:
        data = str(Path(folder) / "davinci")
        answer("import", str(RECORDED), "--out", data)
        found, processor_s = answer(name, data, "--json", *options)
    if name == "compare":
        errors = {"no effect": found["held_out_error"]}
        return {"processor_s": processor_s, "errors": errors, "verdict": "", "notes": []}
    errors = {row["effect"]: row["held_out_error"] for row in found["ranking"][:3]}
    notes = [note for note in found["notes"] if "× the noise" in note]
    return {"processor_s": processor_s, "errors": errors, "verdict": found["verdict"], "notes": notes}


def table(rows: list[Row], _: Namespace) -> str:
    """The figures, and the notes of each diagnosis."""
    heads = ("command", "processor time s", "with one effect: error left out × the noise", "verdict")
    told = answered(rows)
    lines = []
    for row in told:
        errors = ", ".join(f"{effect} {error:.1f}" for effect, error in row["errors"].items())
        lines.append((row["command"], f"{row['processor_s']:.0f}", errors, row["verdict"]))
    notes = [f"\n`{row['command']}`: {note}" for row in told for note in row["notes"]]
    return "\n".join([markdown(heads, lines), *notes])


CAMPAIGN = Campaign(__doc__, plan, ask, table)
