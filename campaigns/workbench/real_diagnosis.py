"""What the workbench says by itself of the real recordings, and how long one core takes for it.

scripts/evidence real_diagnosis real_diagnosis
real_diagnosis --max-effects 6                  one row more, of most of an hour
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from campaigns import ROOT

RECORDED = ROOT / "config/recordings/davinci.yaml"
EFFECTS = ROOT / "config/recordings/effects"


def answer(*arguments: str) -> tuple[dict[str, Any], float]:
    """The JSON answer of a command and its processor time, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "needle_rig", *arguments]
    told = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return json.loads(told.stdout) if "--json" in arguments else {}, after.ru_utime - before.ru_utime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--max-effects", type=int, help="a diagnosis that may name so many, too")
    given = parser.parse_args()
    runs = [("diagnose --quick", ["--quick"]), ("diagnose", [])]
    if given.max_effects:
        runs.append(
            (f"diagnose --max-effects {given.max_effects}", ["--max-effects", str(given.max_effects)])
        )
    with tempfile.TemporaryDirectory() as folder:
        data = str(Path(folder) / "davinci")
        answer("import", str(RECORDED), "--out", data)
        notes = []
        print("| command | processor time s | error on commands left out × the noise | verdict |")
        print("|---|---|---|---|")
        found, cpu_s = answer("compare", data, "--json")
        print(f"| compare | {cpu_s:.0f} | {found['held_out_error']:.1f} | |", flush=True)
        for title, options in runs:
            found, cpu_s = answer(
                "diagnose", data, "--effects", str(EFFECTS), "--jobs", "1", "--json", *options
            )
            alone = ", ".join(f"{row['effect']} {row['held_out_error']:.1f}" for row in found["ranking"][:3])
            print(f"| {title} | {cpu_s:.0f} | one effect: {alone} | {found['verdict']} |", flush=True)
            notes += [f"`{title}`: {note}" for note in found["notes"] if "× the noise" in note]
    print("\n" + "\n\n".join(notes))


if __name__ == "__main__":
    main()
