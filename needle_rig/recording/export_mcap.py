"""A run as MCAP: one channel a source, JSON messages with a schema, for viewers such as Foxglove."""

from __future__ import annotations

import datetime
import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.recording.reader import RunFile
from needle_rig.recording.tables import at_edge
from needle_rig.records import JsonObject
from needle_rig.version import VERSION


def export_mcap(run: RunFile, path: str | os.PathLike[str]) -> Path:
    """Write `run` to a new MCAP file at `path`; raises BadInput when it exists, or without the extra `mcap`.

    Message times are UTC: the run's first row stands at `started_utc`. Angles are degrees, torques N·mm.
    """
    target, mcap = Path(path), needed("mcap.writer", "an MCAP file", "mcap")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        file = target.open("xb")
    except FileExistsError:
        raise BadInput(f"{show_path(target)}: exists already; name another place") from None
    except OSError as error:
        raise BadInput(f"{show_path(target)}: cannot be made: {error.strerror}") from None
    begin_s, begin_ns = run.span_s[0], _started_ns(run)
    with file:
        writer = mcap.Writer(file)
        writer.start(profile="", library=f"needle-rig {VERSION}")
        writer.add_metadata("run", {name: _text(value) for name, value in run.attributes.items()})
        messages: list[tuple[int, int, int, bytes]] = []
        for name in run.tables:
            rows = run.table(name)
            fields = rows.dtype.names or ()
            channel = _channel(
                writer, name, {at_edge(field)[0]: _kind(rows.dtype[field]) for field in fields}
            )
            columns = {at_edge(field)[0]: _values(rows[field], at_edge(field)[1]) for field in fields}
            for number, values in enumerate(zip(*columns.values(), strict=True)):
                message = dict(zip(columns, values, strict=True))
                when_ns = max(0, begin_ns + round((float(rows["time_s"][number]) - begin_s) * 1e9))
                messages.append((when_ns, channel, number, json.dumps(message).encode()))
        events = {"time_s": {"type": "number"}, "kind": {"type": "string"}, "text": {"type": "string"}}
        channel = _channel(writer, "events", events)
        for number, event in enumerate(run.events):
            when_ns = max(0, begin_ns + round((event.time_s - begin_s) * 1e9))
            message = {"time_s": event.time_s, "kind": event.kind, "text": event.text}
            messages.append((when_ns, channel, number, json.dumps(message).encode()))
        for when_ns, channel, number, raw in sorted(messages, key=lambda entry: entry[:3]):
            writer.add_message(channel, log_time=when_ns, data=raw, publish_time=when_ns, sequence=number)
        writer.finish()
    return target


def _channel(writer: Any, name: str, properties: Mapping[str, object]) -> int:
    schema = {"type": "object", "title": name, "properties": properties}
    schema_id = writer.register_schema(f"needle_rig.{name}", "jsonschema", json.dumps(schema).encode())
    return int(writer.register_channel(topic=f"/{name}", message_encoding="json", schema_id=schema_id))


def _kind(dtype: np.dtype[Any]) -> JsonObject:
    if dtype.subdtype is not None:
        return {"type": "array", "items": _kind(dtype.subdtype[0])}
    return {"type": {"S": "string", "b": "boolean", "f": ["number", "null"]}.get(dtype.kind, "integer")}


def _values(values: np.ndarray[Any, Any], convert: Callable[[Any], Any]) -> list[Any]:
    if values.dtype.kind == "S":
        return [value.decode("utf-8", "replace") for value in values.tolist()]
    if values.dtype.kind != "f":
        plain: list[Any] = values.tolist()
        return plain
    return [_finite(value) for value in np.round(convert(values), 9).tolist()]


def _finite(value: Any) -> Any:
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return value if math.isfinite(value) else None


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    return json.dumps(value.tolist() if isinstance(value, np.ndarray) else value, ensure_ascii=False)


_LAST_NS = 1 << 62
"""MCAP counts in 64 bits; the year 2116 leaves room for the run."""


def _started_ns(run: RunFile) -> int:
    try:
        started = datetime.datetime.fromisoformat(str(run.attributes["started_utc"]))
        started_ns = round(started.timestamp() * 1e9)
    except (KeyError, ValueError, OverflowError):
        return 0
    return started_ns if 0 < started_ns < _LAST_NS else 0
