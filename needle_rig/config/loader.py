"""From a rig file to a checked RigConfig."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Mapping
from typing import Any, get_args

from needle_rig.config.check import validate
from needle_rig.config.directories import config_directories
from needle_rig.config.file_kinds import as_read_here
from needle_rig.config.files import find_config_file, parameters_path
from needle_rig.config.places import DataPath, Places, parse_yaml, read_yaml, write_yaml
from needle_rig.config.schema import NodeDevice, RigConfig, TextHall
from needle_rig.errors import BadInput
from needle_rig.records import JsonObject

DECIMAL_PLACE = math.sqrt(10.0)
"""Two numbers that are further apart than this factor are nearer to a slip of a decimal place than to each
other; what is less far apart, `needle-rig check` warns of."""

__all__ = [
    "Places",
    "config_directories",
    "find_config_file",
    "load_rig_config",
    "parse_rig_config",
    "parse_yaml",
    "read_yaml",
    "rig_config_text",
    "validate",
    "write_yaml",
]


def load_rig_config(
    path: str | os.PathLike[str] | None = None, overrides: Mapping[str, object] | None = None
) -> RigConfig:
    """The rig file at `path`, or the nearest rig.yaml; every error carries file, line and column.

    `overrides` maps dotted keys ("sequence.settle_s") to values that replace those of the file, as options of
    a command do; None leaves the file's value. Raises BadInput.
    """
    data, places = read_yaml(find_config_file("rig.yaml") if path is None else path)
    config, places = _build(data, places, overrides or {})
    if config.simulation is not None:
        # of this computer, as the ports: the rig inside a run stays readable without the file
        try:
            found = parameters_path(config.simulation.parameters)
        except BadInput as error:
            raise places.error(("simulation", "parameters"), str(error)) from None
        if not os.path.lexists(found):
            raise places.error(
                ("simulation", "parameters"),
                f"there is no file {found} below {os.getcwd()}; name a parameter set, or give the whole path",
            )
    return config


def parse_rig_config(text: str, name: str = "config") -> RigConfig:
    """The rig in `text`, such as the config inside a run; `name` stands for the file in errors."""
    data, places = parse_yaml(text, name)
    return _build(data, places, {})[0]


def rig_config_text(config: RigConfig) -> str:
    """The whole effective configuration as YAML; `parse_rig_config` gives back an equal one."""
    return write_yaml(config.model_dump(mode="json", exclude_none=True))


def _build(data: JsonObject, places: Places, overrides: Mapping[str, object]) -> tuple[RigConfig, Places]:
    """The rig with `overrides` in it, and where its values stand then."""
    given: dict[DataPath, object] = {
        tuple(key.split(".")): value for key, value in overrides.items() if value is not None
    }
    if "format" in data:  # options name the keys of today
        data = as_read_here(data, places, *get_args(RigConfig.model_fields["format"].annotation))
    # The file is judged by itself first, so that an option never hides a mistake in it.
    config = validate(RigConfig, data, places)
    if given:
        for path, value in given.items():
            section: Any = data
            for part in path[:-1]:
                section = section.setdefault(part, {})
            section[path[-1]] = value
        written = {**places.written, **{path: str(value) for path, value in given.items()}}
        places = dataclasses.replace(places, written=written, options=frozenset(given))
        config = validate(RigConfig, data, places)
    problems = [f"{places.of(path)}: {sentence}" for path, sentence in _contradictions(config)]
    if problems:
        raise BadInput("\n".join(problems))
    return config, places


def _contradictions(config: RigConfig) -> Iterator[tuple[DataPath, str]]:
    """What each value alone cannot show: (path, sentence) for every pair that cannot go together."""
    yield from _needle_contradictions(config)
    yield from _layout_contradictions(config)
    yield from _link_contradictions(config)
    drive, sequence = config.drive, config.sequence
    if sequence.speed_deg_s > drive.velocity_limit_deg_s:
        yield (
            ("sequence", "speed_deg_s"),
            f"sequence.speed_deg_s: {sequence.speed_deg_s:g}°/s is above drive.velocity_limit_deg_s: "
            f"{drive.velocity_limit_deg_s:g}°/s; lower the one or raise the other",
        )
    if sequence.torque_window_s > sequence.settle_s:
        yield (
            ("sequence", "torque_window_s"),
            f"sequence.torque_window_s: {sequence.torque_window_s:g} s is longer than sequence.settle_s: "
            f"{sequence.settle_s:g} s; the torque is averaged over the end of the settling",
        )


def _needle_contradictions(config: RigConfig) -> Iterator[tuple[DataPath, str]]:
    needle = config.needle
    stated_nmm2 = needle.torsional_rigidity_nmm2
    if stated_nmm2 is None:
        return
    by_size_nmm2 = needle.shear_modulus_gpa * 1e3 * math.pi * needle.diameter_mm**4 / 32.0
    ratio = stated_nmm2 / by_size_nmm2
    if not 1.0 / DECIMAL_PLACE < ratio < DECIMAL_PLACE:
        yield (
            ("needle", "torsional_rigidity_nmm2"),
            f"needle.torsional_rigidity_nmm2: {stated_nmm2:g} N·mm² is {ratio:.2g} times the"
            f" {by_size_nmm2:.3g} N·mm² of {needle.diameter_mm:g} mm and {needle.shear_modulus_gpa:g} GPa;"
            " correct one of the three, or give a tube the modulus of a solid wire as stiff",
        )


def _layout_contradictions(config: RigConfig) -> Iterator[tuple[DataPath, str]]:
    length_mm = config.needle.length_mm
    path: DataPath
    sections = config.layout.tissue_sections_mm
    if not sections:
        yield ("layout", "tissue_sections_mm"), "layout.tissue_sections_mm: give at least one [from, to]"
    previous = None
    for index, (start, end) in enumerate(sections):
        path = ("layout", "tissue_sections_mm", index)
        name = f"layout.tissue_sections_mm[{index}]: [{start:g}, {end:g}]"
        if start >= end:
            yield path, f"{name} ends before it starts; write [from, to] in mm from the base"
        elif start < 0 or end > length_mm:
            yield path, f"{name} leaves the needle, which runs from 0 to needle.length_mm: {length_mm:g}"
        elif previous is not None and start < previous[1]:
            yield path, f"{name} overlaps [{previous[0]:g}, {previous[1]:g}]; give sections in order, apart"
        previous = (start, end)
    sensors = config.layout.hall_sensors
    if not sensors:
        yield ("layout", "hall_sensors"), "layout.hall_sensors: give at least one sensor"
    names: set[str] = set()
    for index, sensor in enumerate(sensors):
        path = ("layout", "hall_sensors", index)
        if sensor.position_mm > length_mm:
            yield (
                (*path, "position_mm"),
                f"layout.hall_sensors[{index}].position_mm: {sensor.name} at {sensor.position_mm:g} mm is "
                f"beyond the needle's tip at needle.length_mm: {length_mm:g}",
            )
        if sensor.name in names:
            yield (*path, "name"), f"layout.hall_sensors[{index}].name: {sensor.name} is used twice"
        names.add(sensor.name)


def _link_contradictions(config: RigConfig) -> Iterator[tuple[DataPath, str]]:
    links = config.links
    if config.kind == "hardware":
        for key, value in links.ports.items():
            if value == "auto":
                yield (
                    ("links", *key.split(".")),
                    f"links.{key}: auto is for kind: simulated; name the port of the rig",
                )
    elif config.simulation is None:
        yield ("kind",), "kind: simulated needs a section simulation: (parameters, seed, …)"
    if isinstance(links.drive, NodeDevice) and not isinstance(links.torque, NodeDevice):
        yield (
            ("links", "torque", "device"),
            f"links.torque.device: {links.torque.device} cannot go with the drive node, which stops without"
            " the torque node's frames on its bus; name another links.drive.device, or leave both at node",
        )
    hall = links.hall
    if isinstance(hall, TextHall) and (hall.angle == "counts") != (hall.counts_per_turn is not None):
        wanted = "give it" if hall.angle == "counts" else "take it away, or say angle: counts"
        yield (
            ("links", "hall", "angle"),
            f"links.hall.counts_per_turn goes with angle: counts alone (it is {hall.angle}); {wanted}",
        )
    if config.simulation is None:
        return
    period_ms = 1000 / config.simulation.sensor_rate_hz
    for key in ("torque_age_limit_ms", "hall_age_limit_ms", "drive_age_limit_ms"):
        limit_ms = getattr(links, key)
        if config.kind == "simulated" and limit_ms < 2 * period_ms:
            yield (
                ("links", key),
                f"links.{key}: {limit_ms:g} ms is below two readings at simulation.sensor_rate_hz: "
                f"{config.simulation.sensor_rate_hz:g} Hz ({2 * period_ms:g} ms)",
            )
