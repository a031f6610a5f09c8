"""MCAP and ROS bags: every number of every message, a table a topic, on the clock of the recorder."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.importing.recording import MAX_COLUMNS, Column, Read

STAMP = "recorded at"
"""The recorder's clock, ns since 1970 in the file."""
MOST_VALUES = 64
"""Of one message; images and clouds have more."""

_ROS_UNITS = {
    "sensor_msgs/msg/JointState": {"position": "rad", "velocity": "rad/s", "effort": "N·m"},
    "geometry_msgs/msg/Wrench": {"torque": "N·m", "force": "N"},
    "geometry_msgs/msg/WrenchStamped": {"torque": "N·m", "force": "N"},
    "geometry_msgs/msg/TwistStamped": {"angular": "rad/s"},
}
"""ROS has one unit a quantity (REP 103); messages of one plain number have none."""

Rows = dict[str, tuple[list[float], list[dict[str, float]], str]]
"""By topic: times in s, numbers by their path, and the kind of message."""


def read_mcap(path: Path, shown: str) -> Read:
    """Dialect in words, columns and no rates; JSON and ROS 2 messages. Raises BadInput."""
    reader = needed("mcap.reader", "an MCAP file", "mcap")
    rows: Rows = {}
    stores: dict[int, Any] = {}
    unread: set[str] = set()
    try:
        with path.open("rb") as file:
            for schema, channel, message in reader.make_reader(file).iter_messages():
                if channel.message_encoding == "json":
                    content = json.loads(message.data)
                elif channel.message_encoding == "cdr" and schema is not None:
                    if schema.id not in stores:
                        stores[schema.id] = _store(schema)
                    content = stores[schema.id].deserialize_cdr(bytes(message.data), schema.name)
                else:
                    unread.add(f"{channel.topic} ({channel.message_encoding})")
                    continue
                _add(rows, channel.topic, message.log_time, content, "" if schema is None else schema.name)
    except BadInput:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged file raises anything, down to struct's errors
        raise BadInput(
            f"{shown}: cannot be read as MCAP: {str(error)[:200]}; `mcap recover` may mend it"
        ) from None
    if not rows and unread:
        raise BadInput(
            f"{shown}: its messages are neither JSON nor ROS 2: {', '.join(sorted(unread)[:4])}; export "
            "them as CSV"
        )
    return "MCAP", _columns(rows, shown), {}


def _store(schema: Any) -> Any:
    typesys = needed("rosbags.typesys", "a bag with ROS messages", "import")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    text = schema.data.decode("utf-8", "replace")
    parse = typesys.get_types_from_idl if schema.encoding == "ros2idl" else typesys.get_types_from_msg
    store.register(parse(text) if schema.encoding == "ros2idl" else parse(text, schema.name))
    return store


def read_bag(path: Path, shown: str) -> Read:
    """Dialect in words, columns and no rates of a bag: a folder or a .db3 of ROS 2, a .bag of ROS 1."""
    highlevel = needed("rosbags.highlevel", "a ROS bag", "import")
    typesys = needed("rosbags.typesys", "a ROS bag", "import")
    rows: Rows = {}
    store = typesys.get_typestore(typesys.Stores.LATEST)
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            kinds = {c.topic: c.msgtype for c in reader.connections}
            for connection, stamp, raw in reader.messages():
                content = reader.deserialize(raw, connection.msgtype)
                _add(rows, connection.topic, stamp, content, kinds[connection.topic])
    except Exception as error:  # noqa: BLE001 - sqlite3's, yaml's and the library's own errors
        raise BadInput(f"{shown}: cannot be read as a ROS bag: {str(error)[:200]}; copy it again") from None
    return "ROS bag", _columns(rows, shown), {}


def _add(rows: Rows, topic: str, stamp_ns: int, content: Any, kind: str) -> None:
    times, values, _ = rows.setdefault(topic, ([], [], kind))
    times.append(stamp_ns * 1e-9)
    values.append(dict(_numbers(content, "", 0)))


def _numbers(node: Any, path: str, depth: int) -> Iterator[tuple[str, float]]:
    if depth > 8:
        return
    if isinstance(node, bool | str | bytes):
        return
    if isinstance(node, int | float | np.number):
        yield path, float(node)
    elif isinstance(node, Mapping) or hasattr(node, "__dataclass_fields__"):
        fields = (
            dict(node)
            if isinstance(node, Mapping)
            else {k: getattr(node, k) for k in node.__dataclass_fields__ if k != "__msgtype__"}
        )
        if set(fields) == {"sec", "nanosec"}:
            yield path, float(fields["sec"]) + 1e-9 * float(fields["nanosec"])
            return
        names = fields.get("name")
        for key, value in fields.items():
            inner = f"{path}.{key}" if path else str(key)
            if (
                isinstance(names, list)
                and isinstance(value, list | np.ndarray)
                and len(value) == len(names) > 0
            ):
                if key != "name":
                    for name, item in zip(names, value, strict=True):
                        yield from _numbers(item, f"{inner}.{name}", depth + 1)
                continue
            yield from _numbers(value, inner, depth + 1)
    elif isinstance(node, list | tuple | np.ndarray) and len(node) <= MOST_VALUES:
        for k, item in enumerate(node):
            yield from _numbers(item, f"{path}[{k + 1}]", depth + 1)


def _columns(rows: Rows, shown: str) -> tuple[Column, ...]:
    columns: list[Column] = []
    for topic, (times, values, kind) in rows.items():
        names = list(dict.fromkeys(name for row in values for name in row))
        if not names or len(times) < 3:
            continue
        columns.append(Column(f"{topic}: {STAMP}", "s", np.array(times), topic))
        units = _ROS_UNITS.get(kind, {})
        for name in names:
            column = np.array([row.get(name, math.nan) for row in values])
            unit = next((u for key, u in units.items() if key in name.split(".")), "")
            unit = "s" if name.endswith("header.stamp") else unit
            columns.append(Column(f"{topic}.{name}" if name else topic, unit, column, topic))
    if not columns:
        raise BadInput(f"{shown}: holds no message with numbers; is it the right file?")
    if len(columns) > MAX_COLUMNS:
        raise BadInput(
            f"{shown}: {len(columns)} numbers a message, more than {MAX_COLUMNS}; keep the rig's topics"
        )
    return tuple(columns)
