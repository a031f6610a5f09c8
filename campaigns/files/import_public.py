"""Do twelve public recordings, rebuilt small, come to an answer as their owners would?

A mapping by `import --guess --machine` is right when nothing is asked and every channel has its column, unit
and sign; asked when what is wrong or missing is named; wrong when it is wrong in silence. What is asked, and
nothing else, is then answered as the owner knows it. `compare`, and `identify` or `diagnose --quick`, must
give an answer. The intervals of friction must meet those of a plain least-squares fit by scipy on the same
channels, widened for the correlation of neighbours.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import subprocess
import sys
import tempfile
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from campaigns.files import public_kinds
from campaigns.files.public_kinds import Is, Public
from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.cli.main import run as command
from needle_rig.importing.unit_text import unit_of

SLIPS = 0.2
"""Of a high rate: a plain script leaves out what is slower, where friction builds up after a reversal."""


BUILT_UP = 0.1
"""Of the span: way after a reversal that a plain script leaves out, over which friction builds up."""


def run(*words: str | Path) -> tuple[int, str, str]:
    """Exit code, answer and all that is printed of a command."""
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        code = command(list(map(str, words)))
    return code, out.getvalue(), out.getvalue() + error.getvalue()


def size(unit: str | None, scale: float) -> float:
    known = unit_of(unit or "")
    return math.nan if known is None else known.si * scale


def faults(mapping: dict[str, Any], case: Public) -> tuple[list[str], list[str]]:
    """What is wrong in silence and what is wrong or missing and asked; what was asked is put right."""
    silent: list[str] = []
    asked: list[str] = []
    found = {c["role"]: c for c in mapping["channels"]}
    for role in sorted(set(found) - set(case.channels)):
        (asked if found[role].get("doubt") else silent).append(f"{role} is no channel of it")
        mapping["channels"] = [c for c in mapping["channels"] if c["role"] != role]
    for role, true in case.channels.items():
        channel = found.get(role)
        if channel is None:
            (asked if any(c.get("doubt") for c in mapping["channels"]) else silent).append(f"no {role}")
            clock = next(c["clock"] for c in mapping["channels"] if c["role"] == "base_angle")
            mapping["channels"].append(
                {"role": role, "clock": clock, "source": true.sources[0], **units(true), "sign": true.sign}
            )
            continue
        wrong = wrongs(channel, true)
        if channel.get("doubt") or channel.get("unit") is None:
            asked.append("; ".join(wrong) or f"{role} is right, and asked")
            if channel["source"] not in true.sources:
                channel["source"] = true.sources[0]
            channel |= {"sign": true.sign, "doubt": "", **units(true)}
        elif wrong:
            silent += wrong
    for name, clock in mapping["clocks"].items():
        if clock.get("doubt"):
            asked.append(f"clock {name}")
            clock["doubt"] = ""
            if case.rate_hz is not None:
                clock["rate_hz"] = case.rate_hz
            elif clock.get("unit") is None:
                clock["unit"] = "s"
    return silent, asked


def units(true: Is) -> dict[str, Any]:
    return {"unit": true.unit, "scale": true.scale}


def wrongs(channel: dict[str, Any], true: Is) -> list[str]:
    wrong = []
    if channel["source"] not in true.sources:
        wrong.append(f"{channel['role']} is {channel['source']}, not {true.sources[0]}")
    elif channel["source"] == true.sources[0] and not math.isclose(
        size(channel.get("unit"), channel.get("scale", 1.0)), size(true.unit, true.scale), rel_tol=1e-6
    ):
        wrong.append(f"{channel['role']} in {channel.get('unit')}, not {true.scale:g} {true.unit}")
    elif channel.get("sign", 1) != true.sign:
        wrong.append(f"{channel['role']} with the sign {channel.get('sign', 1):+d}")
    return wrong


def plain_fit(case: Public) -> dict[str, tuple[float, float]]:
    """Coulomb, viscous and offset in N·m and rad/s, by scipy, with half of their 95 % intervals."""
    from scipy.optimize import curve_fit

    assert case.rate_rad_s is not None
    assert case.torque_nm is not None
    rate, torque = case.rate_rad_s, case.torque_nm
    high = float(np.quantile(np.abs(rate), 0.9))
    turned = np.flatnonzero(np.diff(np.sign(rate)))
    slips = np.abs(rate) > SLIPS * high
    for k in turned:
        slips[k - 1 : k + 2] = False
        way = np.cumsum(np.abs(rate[k + 1 :]))
        slips[k + 1 : k + 1 + int(np.searchsorted(way, BUILT_UP * float(np.ptp(np.cumsum(rate)))))] = False
    if min((rate > 0).mean(), (rate < 0).mean()) < 0.05:

        def law(w: Any, viscous: float, offset: float) -> Any:
            return offset + viscous * w

        names: tuple[str, ...] = ("viscous", "offset")
    else:

        def law(w: Any, coulomb: float, viscous: float, offset: float) -> Any:  # type: ignore[misc]
            return offset + coulomb * np.sign(w) + viscous * w

        names = ("coulomb", "viscous", "offset")
    at, covariance = curve_fit(law, rate[slips], torque[slips])
    left = torque[slips] - law(rate[slips], *at)
    near = min(max(float(left[1:] @ left[:-1] / (left @ left)), 0.0), 0.99)
    reach = 1.96 * np.sqrt(np.diag(covariance) * (1 + near) / (1 - near))
    return {n: (float(v), float(r)) for n, v, r in zip(names, at, reach, strict=True)}


def friction(folder: Path, case: Public) -> tuple[bool, str]:
    """Whether `identify` gives what the plain fit gives, and both in words, in SI."""
    code, out, said = run("identify", folder, "--json")
    if code:
        return False, said.strip().splitlines()[-1][:160]
    told = {e["name"]: e for e in json.loads(out.splitlines()[-1])["estimates"]}
    arm = 1.0 if case.lever_mm is None else case.lever_mm * 1e-3
    good, words = True, []
    for name, (value, reach) in plain_fit(case).items():
        ours = told.get(name, {}).get("value")
        if ours is None:
            if name != "offset" or (told.get("coulomb", {}).get("value") is not None):
                good = False
                words.append(f"{name} not told (scipy {value:.4g} ± {reach:.2g})")
            continue
        # N·mm, or N at the lever; viscous by rad, or by mm
        si = 1e-3 if case.lever_mm is None else arm
        si *= arm * 1e3 if case.lever_mm is not None and name == "viscous" else 1.0
        low, high = (end * si for end in told[name]["interval"])
        meets = low <= value + reach and value - reach <= high
        good &= meets
        words.append(f"{name} {ours * si:.4g} ± {(high - low) / 2:.2g} (scipy {value:.4g} ± {reach:.2g})")
        words[-1] += "" if meets else " ←"
    return good, ", ".join(words)


def diagnosed(folder: Path, case: Public) -> tuple[bool, str]:
    # in a process of its own: a campaign's may have no children
    line = [sys.executable, "-m", "needle_rig", "diagnose", "--quick", str(folder), "--json"]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    code, out, said = done.returncode, done.stdout, done.stdout + done.stderr
    if code not in (0, 1, 3):
        return False, said.strip().splitlines()[-1][:160]
    answer = json.loads(out.splitlines()[-1])
    named = [*answer["effects"], *(e["effect"] for e in answer["ranking"][:4])]
    return any(e in named for e in case.effects), f"diagnose --quick: {', '.join(dict.fromkeys(named))}"


def lagging(folder: Path, lag_deg: float) -> tuple[bool, str]:
    """Whether `identify` gives the half play that the owner sees as the lag of the far end."""
    code, out, said = run("identify", folder, "--json")
    if code:
        return False, said.strip().splitlines()[-1][:160]
    told = {e["name"]: e for e in json.loads(out.splitlines()[-1])["estimates"]}
    ratio = told.get("friction_over_rigidity", {}).get("value")
    if ratio is None:
        return False, "friction over rigidity is not told"
    # of a line of 100 mm that slips all along: friction a length times length² over twice its rigidity
    ours = math.degrees(ratio * 50.0)
    return abs(
        ours / lag_deg - 1.0
    ) < 0.2, f"the far end lags {ours:.3g}° where all slips ({lag_deg:g}° is true)"


def one(name: str, folder: Path) -> tuple[str, bool, list[str]]:
    """right, asked or wrong; whether an answer came of it; and what was said."""
    case = public_kinds.CASES[name](folder)
    words = ["--machine", case.machine]
    words += ["--lever", f"{case.lever_mm:g}"] if case.lever_mm is not None else []
    out = folder / "data"
    code, _, said = run("import", case.file, "--guess", *words, "--out", out)
    end, lines = "right", []
    if case.cleaned is not None:
        if code == 0:
            return "wrong", False, ["nothing is said of the file's fault"]
        lines.append("file: " + said.strip().splitlines()[0][:160])
        case.cleaned(case.file)
        end = "asked"
        code, _, said = run("import", case.file, "--guess", *words, "--out", out)
    place = out.with_suffix(".yaml") if code else out / "import.yaml"
    if not place.exists():
        return "refused", False, [*lines, said.strip().splitlines()[-1][:200]]
    mapping = yaml.safe_load(place.read_text(encoding="utf-8"))
    silent, asked = faults(mapping, case)
    if silent:
        return "wrong", False, [*lines, *silent]
    if asked or code:
        end = "asked"
        lines.append("asked: " + "; ".join(asked))
        place.write_text(yaml.safe_dump(mapping, allow_unicode=True), encoding="utf-8")
        code, _, said = run("import", place, "--out", out)
        if code:
            return end, False, [*lines, said.strip().splitlines()[-1][:200]]
    code, answer, said = run("compare", out)
    compared = (answer if code == 0 else said).strip().splitlines()
    lines.append(f"compare: {compared[0 if code == 0 else -1][:150]}")
    good = code == 0
    if case.torque_nm is not None:
        met, told = friction(out, case)
        good &= met
        lines.append(told)
    if case.lag_deg is not None:
        met, told = lagging(out, case.lag_deg)
        good &= met
        lines.append(told)
    if case.effects:
        met, told = diagnosed(out, case)
        good &= met
        lines.append(told)
    return end, good, lines


def plan(_: Namespace) -> list[Row]:
    """Every recording."""
    return [{"recording": name} for name in public_kinds.CASES]


def ask(task: Row, _: Namespace) -> Row:
    """What its owner gets."""
    with tempfile.TemporaryDirectory(prefix="import_public-") as folder:
        end, good, said = one(task["recording"], Path(folder))
    return {"mapping": end, "answered": good, "said": said}


def table(rows: list[Row], _: Namespace) -> str:
    """How each recording ends, with what was said."""
    lines = []
    for row in answered(rows):
        said = "<br>".join(str(line).replace("|", "¦") for line in row["said"])
        lines.append((row["recording"], row["mapping"], "yes" if row["answered"] else "no", said))
    return markdown(("recording", "mapping", "answered", "said"), lines)


def failed(rows: list[Row]) -> bool:
    return any(row["mapping"] == "wrong" for row in answered(rows))


CAMPAIGN = Campaign(__doc__, plan, ask, table, failed=failed)
