"""One runner for campaigns of rows: plan, ask, resume, table.

A row is a task, its answer, and the commit and policy that it was measured with. Rows are written to
build/campaigns/NAME-COMMIT.jsonl as they come, so a second call goes on where the first one stopped, and a
file holds rows of one commit. A tree with changes is refused: nobody could repeat its rows.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import os
import queue
import signal
import subprocess
import sys
import time
import traceback
from argparse import Namespace
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from campaigns import ROOT
from needle_rig.workbench.policy import POLICY

Row = dict[str, Any]


def _no_options(_: argparse.ArgumentParser) -> None:
    """A campaign without options of its own."""


def _never(_: list[Row]) -> bool:
    """A campaign that promises nothing."""
    return False


@dataclass(frozen=True)
class Campaign:
    """A question that is asked of many tasks."""

    question: str
    plan: Callable[[Namespace], Iterable[Row]]
    """Tasks in the order in which they are asked. Any beginning should be a fair sample."""
    ask: Callable[[Row, Namespace], Row]
    """The answer to a task; `skipped`, with a reason, where it cannot be asked."""
    table: Callable[[list[Row], Namespace], str]
    """The figures of all rows, in Markdown."""
    size: int = 1
    counts: str = "the plan has one size"
    """What `--size` counts."""
    options: Callable[[argparse.ArgumentParser], None] = _no_options
    failed: Callable[[list[Row]], bool] = _never
    """Whether rows break a promise: exit code 1, as of a crash."""
    rows_a_process: int | None = None
    """A process ends after so many rows, where they take much memory."""
    jobs: int | None = None
    """Rows asked at once, where it is not one a core."""


def commit() -> str:
    """The tree's commit, with a + when tracked files differ from it."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty=+", "--exclude=*"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or "unknown+"


def policy() -> str:
    """The first 12 digits of the SHA-256 of all thresholds."""
    text = json.dumps(POLICY.as_json(), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def key(task: Row) -> str:
    """What tells a task from others."""
    return json.dumps(task, sort_keys=True, ensure_ascii=False)


def answered(rows: Iterable[Row]) -> list[Row]:
    """Rows with an answer: neither skipped nor crashed."""
    return [row for row in rows if "skipped" not in row and "crash" not in row]


def markdown(heads: Sequence[str], lines: Iterable[Iterable[object]]) -> str:
    """A table of cells."""
    cells = (f"| {' | '.join(map(str, line))} |" for line in (heads, *lines))
    return "\n".join([next(cells), "|---" * len(heads) + "|", *cells])


def asked(campaign: Campaign, task: Row, given: Namespace) -> Row:
    """The row of a task; a crash is an answer too."""
    begun = _processor_s()
    try:
        answer = campaign.ask(task, given)
    except Exception:  # noqa: BLE001 it is counted
        answer = {"crash": traceback.format_exc(limit=-4)}
    return {"task": task, **task, **answer, "cpu_s": round(_processor_s() - begun, 1)}


def _processor_s() -> float:
    """Of this process and of its children that have ended."""
    return sum(os.times()[:4])


def counted(rows: list[Row], planned: int) -> str:
    """Which code the rows were measured with, how many there are, what they took, what is not asked."""
    lines = []
    for commit_, policy_ in sorted({(row["commit"], row["policy"]) for row in rows}):
        lines.append(f"{len(rows)} of {planned} rows, measured at {commit_} with policy {policy_}.")
    if taken := sorted(row["cpu_s"] for row in answered(rows)):
        lines.append(
            f"Processor time of a row: median {taken[len(taken) // 2]:.0f} s, 95 % below"
            f" {taken[int(0.95 * (len(taken) - 1))]:.0f} s, {sum(taken) / 3600:.1f} h in all."
        )
    for why in sorted({row["skipped"] for row in rows if "skipped" in row}):
        lines.append(f"Not asked in {sum(row.get('skipped') == why for row in rows)} rows: {why}.")
    for row in rows:
        if "crash" in row:
            lines.append(f"Crashed: `{key(row['task'])}`: {row['crash'].splitlines()[-1]}")
    return "\n".join(f"- {line}" for line in lines)


def _parsed(name: str, campaign: Campaign, words: list[str]) -> Namespace:
    parser = argparse.ArgumentParser(
        prog=f"python -m campaigns {name}",
        description=campaign.question,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--size", type=int, default=campaign.size, help=campaign.counts)
    parser.add_argument("--first-seed", type=int, default=0, help="another number makes fresh datasets")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin nothing new after; 0: the table")
    parser.add_argument("--jobs", type=int, default=campaign.jobs or len(os.sched_getaffinity(0)))
    parser.add_argument("--rows", type=Path, help="file of rows; build/campaigns/NAME-COMMIT.jsonl")
    parser.add_argument(
        "--where", metavar="FIELD=VALUE", action="append", default=[], help="such tasks alone"
    )
    parser.add_argument("--only", metavar="TASK", help="print the row of one task, given as JSON")
    campaign.options(parser)
    return parser.parse_args(words)


def run(name: str, campaign: Campaign, words: list[str]) -> int:
    """Ask what has no row yet, then print the table. Exit code 2 for rows that would not be evidence."""
    given = _parsed(name, campaign, words)
    if given.only:
        row = asked(campaign, json.loads(given.only), given)
        print(json.dumps(row, indent=1, ensure_ascii=False))
        return int("crash" in row)
    code = commit()
    file = given.rows or ROOT / f"build/campaigns/{name}-{code}.jsonl"
    rows = read_rows(file)
    where = [each.partition("=")[::2] for each in given.where]
    tasks = [t for t in campaign.plan(given) if all(str(t.get(field)) == value for field, value in where)]
    done = {key(row["task"]) for row in rows}
    left = [task for task in tasks if key(task) not in done] if given.minutes > 0 else []
    if left:
        if code.endswith("+"):
            print(
                f"the tree at {code} has changes: rows are evidence of a commit; commit first",
                file=sys.stderr,
            )
            return 2
        if others := {(row["commit"], row["policy"]) for row in rows} - {(code, policy())}:
            print(f"{file} holds rows of {sorted(others)}, not of {code}: name another file", file=sys.stderr)
            return 2
        try:
            _ask_all(name, campaign, left, given, file, rows)
        except KeyboardInterrupt:
            print("stopped", file=sys.stderr)
    print(campaign.table(rows, given) + "\n\n" + counted(rows, len(tasks)))
    return int(campaign.failed(rows) or any("crash" in row for row in rows))


def read_rows(file: Path) -> list[Row]:
    """The rows of a file; none where there is no file."""
    return (
        [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
    )


def _ask_all(
    name: str, campaign: Campaign, left: list[Row], given: Namespace, file: Path, rows: list[Row]
) -> None:
    """Ask on a pool; each row is appended to `file` and `rows` as it comes."""
    until = time.monotonic() + 60.0 * given.minutes
    measured = {"commit": commit(), "policy": policy()}
    waiting, running, planned = left[::-1], 0, len(left) + len(rows)
    answers: queue.SimpleQueue[Row | BaseException] = queue.SimpleQueue()
    context = multiprocessing.get_context("spawn")
    ignore = (signal.SIGINT, signal.SIG_IGN)
    file.parent.mkdir(parents=True, exist_ok=True)
    with (
        context.Pool(given.jobs, signal.signal, ignore, campaign.rows_a_process) as pool,
        file.open("a", encoding="utf-8") as out,
    ):
        while True:
            while running < given.jobs and waiting and time.monotonic() < until:
                task = waiting.pop()
                pool.apply_async(
                    asked, (campaign, task, given), callback=answers.put, error_callback=answers.put
                )
                running += 1
            if not running:
                return
            row = answers.get()
            running -= 1
            if isinstance(row, BaseException):
                raise row
            row |= measured
            rows.append(row)
            out.write(json.dumps(row, ensure_ascii=False) + "\n")
            out.flush()
            print(f"{len(rows)}/{planned} {_said(row)}", file=sys.stderr, flush=True)


def _said(row: Row) -> str:
    said = row.get("skipped") or row.get("crash", "").strip().rpartition("\n")[2] or row.get("verdict", "")
    return f"{key(row['task'])[:160]}: {said} {', '.join(row.get('named', ()))} {row['cpu_s']} s"
