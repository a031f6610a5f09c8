"""The rig file of a service: the shipped one of a real rig with what a person answered."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from needle_rig.config.files import shipped_file
from needle_rig.config.loader import parse_rig_config

_HEAD = """\
# The rig of this computer. After a change: needle-rig check, then sudo systemctl restart needle-rig
# Units are in the key names; a key that is not known here is refused with its line.
"""

_KEEP = "# beyond it the oldest runs go that were exported or diagnosed; without this line all stay"
_KEPT_SHARE = 0.5
"""Of the disk: the rest is for runs that nobody read yet, which never go, and for all else."""


def keep_gb(runs: Path) -> float:
    """What runs may take on the disk of `runs`, there already or not."""
    there = next(folder for folder in (runs, *runs.parents) if folder.exists())
    return _KEPT_SHARE * shutil.disk_usage(there).total / 1e9


@dataclass(frozen=True)
class Answers:
    """What tells one rig from another, in the units of a rig file."""

    name: str
    can: str
    """A network interface, or the device of a serial adapter that speaks slcan."""
    bitrate_kbit_s: int
    hall_port: str
    length_mm: float
    diameter_mm: float
    shear_modulus_gpa: float
    keep_gb: float
    """What all runs may take before the oldest that were read go."""

    @property
    def network_interface(self) -> str | None:
        """The interface that must be brought up; None for a serial adapter."""
        return None if "/" in self.can else self.can


def rig_file_text(answers: Answers, runs: Path) -> str:
    """The rig file with `answers` and the folder of the `runs`. Raises BadInput for what cannot be used."""
    text = shipped_file("rig.hardware.yaml").read_text(encoding="utf-8")
    text = _HEAD + text[text.index("format:") :]
    if answers.network_interface is None:
        can = (
            f"{{interface: slcan, channel: {_quoted(answers.can)}, bitrate_kbit_s: {answers.bitrate_kbit_s}}}"
        )
    else:
        can = f"{{interface: socketcan, channel: {_quoted(answers.can)}}}"
    for key, value in (
        ("name", _quoted(answers.name)),
        ("can", can),
        ("hall", f"{{port: {_quoted(answers.hall_port)}, baud: 921600}}"),
        ("length_mm", f"{answers.length_mm:g}"),
        ("diameter_mm", f"{answers.diameter_mm:g}"),
        ("shear_modulus_gpa", f"{answers.shear_modulus_gpa:g}"),
        ("directory", f"{_quoted(str(runs))}\n  keep_gb: {answers.keep_gb:.3g}   {_KEEP}"),
    ):
        text = _with(text, key, value)
    parse_rig_config(text, "the rig file of these answers")
    return text


def _with(text: str, key: str, value: str) -> str:
    """`text` with another value at the one line of `key`."""
    changed, count = re.subn(rf"(?m)^( *{key}: ).*$", lambda found: found[1] + value, text)
    if count != 1:
        raise ValueError(f"the shipped rig file has {count} lines of {key}")
    return changed


def _quoted(text: str) -> str:
    """`text` as a YAML scalar that is text whatever it looks like."""
    return "'" + text.replace("'", "''") + "'"
