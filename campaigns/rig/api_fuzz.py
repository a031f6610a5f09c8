"""Asks a daemon in virtual time everything that its OpenAPI document allows, and what it forbids.

Schemathesis makes the requests from /openapi.json: valid ones, and ones that break the document in one
place. No answer may be 5xx, be no JSON, or have a status that the document does not name; the daemon must
answer its state at the end, with no run begun by a request that was refused. Exit code 1 when any does.
It needs: pip install schemathesis
"""

from __future__ import annotations

import collections
import contextlib
import logging
import tempfile
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict

import httpx
import hypothesis
import schemathesis
from hypothesis import HealthCheck
from schemathesis.core.result import Ok

from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.service.client import private_daemon

logging.disable(logging.WARNING)


class Operation(TypedDict):
    """What is read of an operation in the daemon's OpenAPI document."""

    responses: Mapping[str, object]


def plan(given: Namespace) -> list[Row]:
    return [{"mode": mode.value, "examples": given.size} for mode in schemathesis.GenerationMode]


def ask(task: Row, _: Namespace) -> Row:
    """How one daemon answers the requests of one mode."""
    statuses: collections.Counter[tuple[str, str, int]] = collections.Counter()
    bad: list[str] = []
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        with private_daemon(["--fast", f"--out={folder}"]) as daemon:
            transport = httpx.HTTPTransport(uds=str(daemon.path))
            with httpx.Client(transport=transport, base_url="http://daemon", timeout=30) as client:
                document = client.get("/openapi.json").json()
                schema = schemathesis.openapi.from_dict(document)
                mode = schemathesis.GenerationMode(task["mode"])
                for result in schema.get_all_operations():
                    assert isinstance(result, Ok), result
                    ask_all(client, document["paths"], result.ok(), mode, task["examples"], statuses, bad)
                client.post("/stop")
                phase = client.get("/state").json()["phase"]
        files = len(list(Path(folder).glob("*.h5")))
    begun = sum(n for (_, *asked), n in statuses.items() if asked == ["/compensate", 202])
    answers = [[*asked, count] for asked, count in sorted(statuses.items())]
    return {"answers": answers, "phase": phase, "bad": bad, "begun": begun, "files": files}


def ask_all(
    client: httpx.Client,
    documented_paths: Mapping[str, Mapping[str, Operation]],
    operation: Any,
    mode: Any,
    examples: int,
    statuses: collections.Counter[tuple[str, str, int]],
    bad: list[str],
) -> None:
    method, path = operation.method.upper(), operation.path
    documented = {int(status) for status in documented_paths[path][method.lower()]["responses"]}

    @hypothesis.settings(
        max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @hypothesis.given(case=operation.as_strategy(generation_mode=mode))
    def ask(case: Any) -> None:
        told = case.as_transport_kwargs(base_url="http://daemon")
        content = {"json": told["json"]} if "json" in told else {"content": told.get("data")}
        try:
            headers = {name: value.encode("latin-1") for name, value in dict(told["headers"]).items()}
            if sum(statuses.values()) % 4:  # a lease that nobody gave is refused before anything else
                headers = {name: value for name, value in headers.items() if name.lower() != "lease"}
            answer = client.request(
                told["method"], told["url"], headers=headers, params=told.get("params"), **content
            )
        except (UnicodeEncodeError, httpx.LocalProtocolError):
            return  # what HTTP cannot carry
        statuses[method, path, answer.status_code] += 1
        known = answer.status_code in documented or answer.status_code in (404, 405, 307)
        if answer.status_code >= 500 or not known:
            bad.append(f"{method} {path} {told}: {answer.status_code} {answer.text[:200]}")
        elif answer.headers.get("content-type") != "application/json" and answer.status_code not in (
            400,
            307,
        ):
            bad.append(f"{method} {path}: {answer.status_code} is no JSON: {answer.text[:200]}")

    client.post("/stop")  # ends a lease that an operation before took
    with contextlib.suppress(hypothesis.errors.Unsatisfiable):  # then there is nothing to ask
        ask()


def table(rows: list[Row], _: Namespace) -> str:
    """How often each operation was answered with which status, and the answers that are bad."""
    lines, notes = [], [""]
    for row in answered(rows):
        lines += [(row["mode"], f"{method} {path}", *told) for method, path, *told in row["answers"]]
        notes.append(
            f"- {row['mode']}: {sum(each[-1] for each in row['answers'])} requests, phase {row['phase']};"
            f" {row['begun']} runs begun, {row['files']} files; {len(row['bad'])} bad answers"
        )
        notes += [f"- {each}" for each in row["bad"][:20]]
    return "\n".join([markdown(("mode", "operation", "status", "answers"), lines), *notes])


def failed(rows: list[Row]) -> bool:
    return any(row["bad"] or row["files"] > row["begun"] for row in answered(rows))


CAMPAIGN = Campaign(__doc__, plan, ask, table, 100, "examples of each operation (100)", failed=failed)
