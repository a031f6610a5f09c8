"""Damage for files of every kind: what bits, people and attackers do to them."""

from __future__ import annotations

import json
import os
import random
import re
import socket
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from needle_rig.recording.superblock import SUPERBLOCK_BYTES, Superblock

VALUES = (
    "1e308", "-1e308", "1e999", ".nan", ".inf", "-.inf", "0", "-1", "1e-320", "9" * 30, '"x"', "null",
    "true", "[]", "{}", "[1, [2, [3]]]", "2026-01-01", "0x7fffffff", '"<script>alert(1)</script>"',
    '"a\\nb"', '"../../../etc/passwd"', '"/etc/passwd"', '"\\u0000"', '"\\x1b[2J"', '"\\ud800"', '""',
    "1_000", '"[/b]"', "12:30:45", "!!python/object/apply:os.getpid []", "&a [*a]", '!!binary "AAAA"',
    "1e400000",
    "'" + "x" * 5000 + "'",
)  # fmt: skip
BOMB = "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 10))
NUMBERS = (
    "1e308",
    "-1e308",
    "1e999",
    "nan",
    "inf",
    "9" * 400,
    "1e-400",
    "0x10",
    "-",
    "1e",
    "1.2.3",
    "--1",
    "<b>",
    "",
)


def damaged_bytes(raw: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Flipped bits, a cut, a block lost, doubled or zeroed, foreign bytes."""
    content = bytearray(raw)
    at = rng.randrange(max(1, len(content)))
    block = slice(at, at + rng.choice((1, 16, 512, 4096)))
    how = rng.choice(("flip", "flips", "cut", "lost", "doubled", "zeroed", "foreign", "nothing"))
    if how in ("flip", "flips"):
        for _ in range(1 if how == "flip" else rng.randint(2, 30)):
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    elif how == "cut":
        del content[at:]
    elif how == "lost":
        del content[block]
    elif how == "doubled":
        content[at:at] = content[block]
    elif how == "zeroed":
        content[block] = bytes(len(content[block]))
    elif how == "foreign":
        content[at:at] = rng.randbytes(rng.choice((1, 4, 100)))
    else:
        content = bytearray(
            rng.choice((b"", b"\n", b"\0" * 100, b"\xff\xfe", b"\xff\xfe\x00", b"null", b"[]", b"---\n---\n"))
        )
    return how, bytes(content)


def damaged_yaml(raw: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Values of another kind, lines lost, doubled or exchanged, bombs, nesting; sometimes plain damage."""
    text = raw.decode()
    how = rng.choice(
        ("value",) * 6 + ("bytes",) * 3 + ("lost", "doubled", "swapped", "key", "bomb", "deep", "digits")
    )
    if rng.random() < 0.02:
        how = "many"
    if how == "bytes":
        return damaged_bytes(raw, rng)
    if how == "value":
        spots = list(
            re.finditer(r"(?<=: )[^\s,{}\[\]#][^,}\n#\]]*|(?<=[\[,] )-?[0-9.]+|(?<=\[)-?[0-9.]+", text)
        )
        spot, value = rng.choice(spots), rng.choice(VALUES)
        return f"{spot[0][:20]} → {value[:20]}", (text[: spot.start()] + value + text[spot.end() :]).encode()
    lines = text.splitlines()
    one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    if how == "lost":
        del lines[one]
    elif how == "doubled":
        lines.insert(one, lines[one])
    elif how == "swapped":
        lines[one], lines[other] = lines[other], lines[one]
    elif how == "key":
        spot = rng.choice(list(re.finditer(r"[a-z_0-9]+(?=:)", text)))
        key = rng.choice(("<b>", "x\u202e", "? [a]", "1", "null", '"a\\tb"', "<<"))
        return f"key {spot[0]}", (text[: spot.start()] + key + text[spot.end() :]).encode()
    elif how == "bomb":
        lines = [*BOMB.splitlines(), *lines, "more: *a9"]
    elif how == "deep":
        lines.append("x: " + "[" * 5000 + "]" * 5000)
    elif how == "digits":
        lines.append("x: " + "9" * 200_000)
    else:
        lines.append("x: [" + "1," * 300_000 + "]")
    return how, "\n".join([*lines, ""]).encode()


def damaged_csv(raw: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Numbers that are none, columns and rows lost or doubled, other separators, odd clocks."""
    rows = [line.split(",") for line in raw.decode().splitlines()]
    ways = (
        ("number",) * 4
        + ("bytes",) * 4
        + ("lost", "doubled", "header", "columns", "rows", "clock", "utf-16", "line")
    )
    how = rng.choice(ways)
    column = rng.randrange(len(rows[0]))
    if how == "bytes":
        return damaged_bytes(raw, rng)
    if how == "number":
        value = rng.choice(NUMBERS)
        for row in rng.sample(rows[1:], rng.choice((1, 5, len(rows) - 1))):
            row[column] = value
        how = f"{rows[0][column]} = {value[:12]}"
    elif how == "lost":
        rows = [[field for n, field in enumerate(row) if n != column] for row in rows]
    elif how == "doubled":
        rows = [[*row, row[column]] for row in rows]
    elif how == "header":
        rows[0] = [
            rng.choice((name.upper(), name.replace("_deg", "_rad"), f'"{name}"', "[/b]", "\x1b[2J", ""))
            for name in rows[0]
        ]
    elif how == "columns":
        count = rng.choice((900, 2000, 300_000))
        rows = [
            [*row, *([f"c{n}" for n in range(count)] if row is rows[0] else ["0"] * count)]
            for row in rows[:4]
        ]
    elif how == "rows":
        rows += [[f"{100 + n * 1e-3:.3f}", *rows[-1][1:]] for n in range(200_000)]
    elif how == "clock":
        clocks: tuple[Callable[[int], str], ...] = (
            lambda n: "0",
            lambda n: f"{-n}",
            lambda n: f"{n * 1e300}",
            lambda n: f"{n * 1e-12}",
            lambda n: "nan",
        )
        clock = rng.choice(clocks)
        for number, row in enumerate(rows[1:]):
            row[0] = clock(number)
    elif how == "line":
        rows.insert(1, ["1" * 5_000_000])
    text = "\n".join(",".join(row) for row in rows) + "\n"
    return how, text.encode("utf-16") if how == "utf-16" else text.encode()


def damaged_json(raw: bytes, rng: random.Random) -> tuple[str, bytes]:
    """A request with other values, unknown keys, or plain damage."""
    if rng.random() < 0.3:
        return damaged_bytes(raw, rng)
    body = json.loads(raw)
    values: tuple[object, ...] = (
        None, True, -1, 0, 1e308, 1e-300, float("nan"), float("inf"), int("9" * 400), "45", "", "a\0b",
        "x" * 100_000, "../../etc/passwd", "__init__", "\ud800", [], [1e308] * 3, [int("9" * 400)],
        [None] * 5000, {}, {"self": 1}, {"__class__": []}, {"steps_deg": ["x"]},
        {"steps_deg": [int("9" * 400)]}, {"extra_deg": float("nan")}, {"duration_s": 1e300},
    )  # fmt: skip
    key = rng.choice([*body, "options", "strategy", "self", "\0"])
    body[key] = rng.choice(values)
    if rng.random() < 0.3:
        return "deep", b'{"options": ' + b'{"a":' * 20_000 + b"1" + b"}" * 20_001
    return f"{key} = {body[key]!r}"[:40], json.dumps(body).encode()


def flipped_bit(raw: bytes, rng: random.Random, number: int) -> tuple[str, bytes]:
    """One bit of a run file, every other time in its first 4 kB."""
    at = rng.randrange(4096 if number % 2 else len(raw))
    content = bytearray(raw)
    content[at] ^= 1 << rng.randrange(8)
    return f"byte {at}", bytes(content)


def cut_run(raw: bytes, rng: random.Random, number: int) -> tuple[str, bytes]:
    """A run file without its end; every other time its head says that it ends there."""
    end = rng.randrange(len(raw))
    content = raw[:end]
    head = Superblock.parse(content[:SUPERBLOCK_BYTES])
    if head is not None and number % 2:
        content = head.closed(end) + content[SUPERBLOCK_BYTES:]
    return f"cut at {end}", content


def other_tables(path: Path, rng: random.Random) -> str:
    """Changes the tables and attributes of the run at `path` through HDF5 itself, checksums and all."""
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        name = rng.choice([*file, "ticks", "events"])
        way = rng.choice(
            (
                _other_type,
                _other_type,
                _other_column,
                _other_values,
                _other_values,
                _other_length,
                _link,
                _attribute,
                _attribute,
            )
        )
        return way(file, name, rng)


def _replace(file: h5py.File, name: str, made: object) -> None:
    del file[name]
    file[name] = made


def _other_type(file: h5py.File, name: str, rng: random.Random) -> str:
    one = np.zeros(4, [("time_s", "f8")])
    made = rng.choice(
        (
            np.arange(10),
            np.zeros((3, 3)),
            one,
            np.zeros(0, one.dtype),
            np.array([b"x"]),
            1.5,
            "text",
            np.zeros((2, 2), one.dtype),
        )
    )
    _replace(file, name, made)
    return f"{name} is {getattr(made, 'dtype', type(made).__name__)}"


def _other_column(file: h5py.File, name: str, rng: random.Random) -> str:
    kind = file[name].dtype
    if kind.names is None:
        return _other_type(file, name, rng)
    column = rng.choice(kind.names)
    other = rng.choice((None, "i8", "S4", "f4", "u1", "?", ("f8", (3,)), ("f8", (2, 2)), "c16", "O"))
    fields = [(n, kind[n] if n != column else other) for n in kind.names if n != column or other is not None]
    fields = [(n, h5py.string_dtype() if k == "O" else k) for n, k in fields]
    rows = np.zeros(rng.choice((0, 5, 500)), fields or [("nothing", "u1")])
    if other == "O":
        rows[column] = "text"
    _replace(file, name, rows)
    return f"{name}.{column} is {other}"


def _other_values(file: h5py.File, name: str, rng: random.Random) -> str:
    rows = file[name][:]
    if rows.dtype.names is None or not len(rows):
        return _other_type(file, name, rng)
    column = rng.choice(rows.dtype.names)
    value = rng.choice((np.nan, np.inf, 1e308, -1e308, -1, 0, 255))
    part = slice(rng.randrange(len(rows)), None) if rng.random() < 0.5 else slice(None)
    text = rows.dtype[column].base.kind == "S"
    with np.errstate(all="ignore"):
        rows[column][part] = (
            rng.choice((b"<b>", b"\xff\xfe", b"\x1b[2J", b""))
            if text
            else np.asarray(value).astype(rows.dtype[column].base)
        )
    file[name][:] = rows
    return f"{name}.{column} = {value}"


def _other_length(file: h5py.File, name: str, rng: random.Random) -> str:
    rows = rng.choice((0, 1, 2, 5, 10**6, 10**12, 2**62))
    try:
        file[name].resize((rows,))
    except (TypeError, ValueError):
        return _other_type(file, name, rng)
    return f"{name} has {rows} rows"


def _link(file: h5py.File, name: str, rng: random.Random) -> str:
    made = rng.choice(
        (h5py.SoftLink(f"/{name}"), h5py.SoftLink("/nowhere"), h5py.ExternalLink("/etc/passwd", "x"), None)
    )
    del file[name]
    if made is not None:
        file[name] = made
    elif rng.random() < 0.5:
        file.create_group(name)
    return f"{name} is {type(made).__name__}"


def _attribute(file: h5py.File, name: str, rng: random.Random) -> str:
    name = rng.choice(list(file.attrs))
    values = (
        1e308, np.nan, -1, 0, "<b>", "a\nb", "\x1b[2J", "x" * 60_000, np.arange(5), b"\xff\xfe", "../../x",
        h5py.Empty("f8"), np.zeros((2, 2)), np.array(["a", "b"], h5py.string_dtype()), file["events"].ref,
        BOMB, "x: [",
    )  # fmt: skip
    value = rng.choice(values)
    if rng.random() < 0.1:
        del file.attrs[name]
        return f"no attribute {name}"
    if rng.random() < 0.3:
        line = (
            rng.choice(
                (
                    b'{"result": []}',
                    b"[1]",
                    b"{" * 9000,
                    b'{"result": {"status": 5, "motions": 3}}',
                    b'{"settle_s": "x"}',
                )
            )
            + b"\n"
        )
        _replace(file, "late_attributes", np.frombuffer(line, "u1"))
        return f"late {line[:30]!r}"
    file.attrs[name] = value
    return f"attribute {name} = {str(value)[:20]!r}"


def no_file(path: Path, rng: random.Random) -> str:
    """Puts something at `path` that is no file to be read."""
    way: Callable[[], object]
    how, way = rng.choice(
        (
            ("pipe", lambda: os.mkfifo(path)),
            ("loop", lambda: path.symlink_to(path.name)),
            ("device", lambda: path.symlink_to("/dev/zero")),
            ("folder", lambda: path.mkdir()),
            ("socket", lambda: _socket(path)),
            ("dangling", lambda: path.symlink_to("nowhere")),
            ("outside", lambda: path.symlink_to("/etc/passwd")),
            ("huge", lambda: _huge(path)),
        )
    )
    way()
    return how


def _socket(path: Path) -> None:
    before = Path.cwd()
    os.chdir(path.parent)  # a socket's path has 107 letters at most
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(before)


def _huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 40)
