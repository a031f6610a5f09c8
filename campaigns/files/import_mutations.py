"""Damages recordings as laboratories do: wrong units in names, swapped columns, rows cut off, other decimal
signs."""

from __future__ import annotations

import dataclasses
import random
import re
from collections.abc import Callable
from pathlib import Path

from campaigns.files.import_kinds import FACTORS, Truth
from needle_rig.importing.bus_log import is_bus_log
from needle_rig.importing.labelled import is_labelled

UNCHANGED = "as it was"
TEXT = (".csv", ".txt", ".tsv", ".dat", ".log", ".lvm", ".asc")


def mutated(truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    """Damages one file in place; the kind of damage, and what is true of the file then."""
    files = [
        f
        for t in truth.files
        for f in ([t] if t.is_file() else sorted(p for p in t.iterdir() if p.is_file()))
    ]
    path = rng.choice(files)
    kinds: list[Callable[[Path, Truth, random.Random], tuple[str, Truth]]] = [_cut, _bits, _emptied, _joined]
    data = path.read_bytes()
    without_table = is_bus_log(data[:512]) or is_labelled(data[:512])
    if path.suffix in TEXT and not data.startswith(b"\xff\xfe") and not without_table:
        kinds = [*kinds[:2], *[_unit_word, _scaled] * 3, *[_swapped_names] * 2]
        kinds += [
            *[_spelled, _unknown_unit, _wrapped] * 2,
            _grouped,
            _lost_field,
            _word,
            _decimal,
            _reversed_time,
            _second_header,
        ]
    for _ in range(20):
        kind, then = rng.choice(kinds)(path, truth, rng)
        if kind != UNCHANGED:
            return kind, then
    return UNCHANGED, truth


def _cut(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    data = path.read_bytes()
    path.write_bytes(data[: rng.randrange(len(data) // 10, len(data))])
    return "cut off", truth


def _bits(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    data = bytearray(path.read_bytes())
    for _ in range(5):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(bytes(data))
    return "bits", truth


def _emptied(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    data = bytearray(path.read_bytes())
    start = rng.randrange(len(data))
    data[start : start + len(data) // 20] = bytes(len(data[start : start + len(data) // 20]))
    path.write_bytes(bytes(data))
    return "zeros", truth


def _joined(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    data = path.read_bytes()
    path.write_bytes(data + data)
    return "twice", truth


def _lines(path: Path) -> tuple[list[bytes], bytes]:
    data = path.read_bytes()
    end = b"\r\n" if b"\r\n" in data else b"\n"
    return data.split(end), end


def _body(lines: list[bytes]) -> int:
    """First line of the table."""
    number = re.compile(rb"^[\s\"]*[-+]?[\d:.,eE+-]+[\s;,|\t\"]")
    return next(
        k for k in range(len(lines) - 2) if all(number.match(b" " + x + b" ") for x in lines[k : k + 3])
    )


def _unit_word(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    """Another unit is written than the numbers are in."""
    lines, end = _lines(path)
    body = _body(lines)
    head = end.join(lines[:body])
    words = [(rb"deg", b"rad"), (b"\xb0", b"rad"), ("°".encode(), b"rad"), (rb"rad", b"deg")]
    words += [(rb"N.?mm|Nmm|mNm|nmm", b"Nm"), (rb"N.m\b|Nm\b", b"Nmm")]
    words += [(rb"\(s\)|\[s\]", b"[ms]"), (rb"\(ms\)|\[ms\]|_ms", b"[s]")]
    there = [(p, w) for p, w in words if re.search(p, head)]
    if not there:
        return UNCHANGED, truth
    pattern, word = rng.choice(there)
    once = rng.random() < 0.5
    new = re.sub(pattern, word, head, count=1 if once else 0)
    path.write_bytes(new + end + end.join(lines[body:]))
    renamed = {}
    for role, (name, factor, sign) in truth.channels.items():
        for text in (pattern,):
            changed = re.sub(text, word, name.encode("utf-8"), count=1 if once else 0).decode(
                "utf-8", "replace"
            )
            renamed[role] = (changed if changed.encode() in new else name, factor, sign)
    return "another unit is written", dataclasses.replace(truth, channels=renamed)


def _delimiter(lines: list[bytes], body: int) -> bytes:
    return next((by for by in (b"\t", b";") if lines[body].count(by) > 1), b",")


def _scaled(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    """One column's numbers in another unit than is written."""
    lines, end = _lines(path)
    body = _body(lines)
    by = _delimiter(lines, body)
    comma = by != b"," and b"," in lines[body]
    width = lines[body].count(by) + 1
    place = rng.randrange(0, max(1, min(width, 1 + len(truth.channels))))
    names = list(truth.channels)
    if place < 1 or place - 1 >= len(names) or by not in lines[body]:
        return UNCHANGED, truth
    role = names[place - 1]
    place = truth.place(role)
    old, factor, sign = truth.channels[role]
    if role == "base_torque":
        by_factor = rng.choice([1e3, 1e-3])
    else:
        by_factor = 57.29577951308232 if factor == FACTORS["rad"] else 1 / 57.29577951308232
    for k in range(body, len(lines)):
        cells = lines[k].split(by)
        if len(cells) != width:
            continue
        try:
            value = float(cells[place].replace(b",", b".") if comma else cells[place]) * by_factor
        except ValueError:
            continue
        text = f"{value:.9f}".encode()
        cells[place] = text.replace(b".", b",") if comma else text
        lines[k] = by.join(cells)
    path.write_bytes(end.join(lines))
    channels = {**truth.channels, role: (old, factor / by_factor, sign)}
    return f"{'torque' if role == 'base_torque' else 'angle'} in another unit", dataclasses.replace(
        truth, channels=channels
    )


def _renamed(truth: Truth, pattern: bytes, word: bytes, head: bytes) -> Truth:
    """The truth once `word` stands for `pattern` in the header `head`."""
    channels = {}
    for role, (name, factor, sign) in truth.channels.items():
        changed = re.sub(pattern, word, name.encode()).decode("utf-8", "replace")
        channels[role] = (changed if changed.encode() in head else name, factor, sign)
    return dataclasses.replace(truth, channels=channels)


def _in_header(
    path: Path, truth: Truth, words: list[tuple[bytes, bytes]], rng: random.Random
) -> Truth | None:
    """One of the `words` (pattern, other) in the header; None where none stands there."""
    lines, end = _lines(path)
    body = _body(lines)
    head = end.join(lines[:body])
    there = [(p, w) for p, w in words if re.search(p, head)]
    if not there:
        return None
    pattern, word = rng.choice(there)
    new = re.sub(pattern, word, head)
    path.write_bytes(new + end + end.join(lines[body:]))
    return _renamed(truth, pattern, word, new)


def _spelled(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    """The same unit in another spelling."""
    words = [(rb"\bdeg\b", "º".encode()), (rb"\bdeg\b", b"degs"), (rb"\brad\b", b"rads")]
    words += [(rb"\bN(\.|\xc2\xb7)?mm\b", b"N-mm"), (rb"\bmNm\b", b"mN*m"), (rb"\(s\)", b"(sec.)")]
    then = _in_header(path, truth, words, rng)
    return (UNCHANGED, truth) if then is None else ("another spelling of a unit", then)


def _unknown_unit(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    """A unit that nobody knows."""
    words = [(rb"(?<=[\[(])deg(?=[\])])", b"zonk"), (rb"(?<=[\[(])rad(?=[\])])", b"units")]
    words += [(rb"(?<=[\[(])(N(\.|\xc2\xb7)?mm|mNm|N-mm)(?=[\])])", b"torqs")]
    then = _in_header(path, truth, words, rng)
    return (UNCHANGED, truth) if then is None else ("a unit that nobody knows", then)


def _wrapped(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    """Angles in degrees from 0 to 360, or from -180 to 180."""
    return _changed(path, truth, "angles wrap", rng.choice((0.0, -180.0)), rng)


def _grouped(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    """Thousands apart in every number."""
    return _changed(path, truth, "thousands apart", None, rng)


def _changed(path: Path, truth: Truth, kind: str, low: float | None, rng: random.Random) -> tuple[str, Truth]:
    """Angles wrapped to the turn from `low` on, or with None a sign between the thousands of all numbers."""
    lines, end = _lines(path)
    body = _body(lines)
    by = _delimiter(lines, body)
    width = lines[body].count(by) + 1
    comma = by != b"," and b"," in lines[body]
    roles = list(truth.channels)
    angles = [truth.place(role) for role in roles if truth.channels[role][1] == FACTORS["deg"]]
    if width != len(roles) + 1 or (by == b"," and low is None) or (low is not None and not angles):
        return UNCHANGED, truth
    begin = 350.0 if low == 0.0 else 170.0
    for k in range(body, len(lines)):
        cells = lines[k].split(by)
        for place in range(width) if len(cells) == width else ():
            try:
                value = float(cells[place].replace(b",", b".") if comma else cells[place])
            except ValueError:
                continue
            if low is None:
                cells[place] = f"{value:,.6f}".translate(str.maketrans(",.", ".,") if comma else {}).encode()
            elif place in angles:
                text = f"{(value + begin - low) % 360.0 + low:.6f}".encode()
                cells[place] = text.replace(b".", b",") if comma else text
        lines[k] = by.join(cells)
    path.write_bytes(end.join(lines))
    return kind, truth


def _lost_field(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    lines, end = _lines(path)
    body = _body(lines)
    by = _delimiter(lines, body)
    k = rng.randrange(body + 5, len(lines) - 3)
    cells = lines[k].split(by)
    del cells[rng.randrange(len(cells))]
    lines[k] = by.join(cells)
    path.write_bytes(end.join(lines))
    return "a field is lost", truth


def _word(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    lines, end = _lines(path)
    body = _body(lines)
    by = _delimiter(lines, body)
    k = rng.randrange(body + 5, len(lines) - 3)
    cells = lines[k].split(by)
    cells[rng.randrange(len(cells))] = rng.choice([b"overrun", b"12.3.4", b"#REF!", b"\xff\xfe"])
    lines[k] = by.join(cells)
    path.write_bytes(end.join(lines))
    return "a word among numbers", truth


def _decimal(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    data = path.read_bytes()
    lines, _ = _lines(path)
    if b"," in lines[_body(lines)] and _delimiter(lines, _body(lines)) == b",":
        path.write_bytes(data.replace(b".", b","))
        return "decimal comma among commas", truth
    return UNCHANGED, truth


def _swapped_names(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    """The header names two columns the wrong way round; what is in them stays."""
    lines, end = _lines(path)
    body = _body(lines)
    by = _delimiter(lines, body)
    at = next((k for k in range(body - 1, -1, -1) if lines[k].count(by) >= 2), None)
    roles = list(truth.channels)
    if at is None or len(roles) < 3 or len(truth.files) > 1:
        return UNCHANGED, truth
    while (
        at > 0
        and lines[at - 1].count(by) == lines[at].count(by)
        and not any(
            n[0].encode("utf-8") in lines[at] or n[0].encode("cp1252", "replace") in lines[at]
            for n in truth.channels.values()
        )
    ):
        at -= 1
    outside_quotes = re.escape(by) + rb'(?=(?:[^"]*"[^"]*")*[^"]*$)'
    cells = re.split(outside_quotes, lines[at])
    first, second = rng.sample(range(1, min(len(cells), 1 + len(roles))), 2)
    a, b = roles[first - 1], roles[second - 1]
    one, other = truth.place(a), truth.place(b)
    cells[one], cells[other] = cells[other], cells[one]
    lines[at] = by.join(cells)
    path.write_bytes(end.join(lines))
    channels = dict(truth.channels)
    channels[a] = (truth.channels[b][0], truth.channels[a][1], truth.channels[a][2])
    channels[b] = (truth.channels[a][0], truth.channels[b][1], truth.channels[b][2])
    kinds = {("base_angle" in (a, b)): "base's", ("base_torque" in (a, b)): "torque's"}
    kind = kinds.get(True, "two sensors'")
    return f"{kind} name swapped", dataclasses.replace(truth, channels=channels)


def _reversed_time(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    lines, end = _lines(path)
    body = _body(lines)
    at = rng.randrange(body + 20, len(lines) - 20)
    lines[body:] = lines[at:] + lines[body:at]
    path.write_bytes(end.join(line for line in lines if line))
    return "halves exchanged", truth


def _second_header(path: Path, truth: Truth, rng: random.Random) -> tuple[str, Truth]:
    lines, end = _lines(path)
    body = _body(lines)
    at = rng.randrange(body + 20, len(lines) - 20)
    lines[at:at] = lines[max(0, body - 1) : body] or [b"new run"]
    path.write_bytes(end.join(lines))
    return "a second header", truth
