"""The mapping: what of a recording is what. One YAML file, a line a channel; it repeats an import."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from needle_rig.config.check import validate
from needle_rig.config.file_kinds import as_read_here
from needle_rig.config.places import Places, read_yaml, write_yaml
from needle_rig.dataset.description import RigPart, layout_of
from needle_rig.errors import BadInput
from needle_rig.importing.axes import OF_ANGLE, OF_TORQUE, SUMMED, USUAL_LEVER_MM, needs_lever
from needle_rig.importing.unit_text import NAMED, Unit, unit_of

FORMAT = "needle-rig-import/1"
BASE, TORQUE, TIP_TORQUE = "base_angle", "base_torque", "tip_torque"
NO_REASON = "the mapping names no reason"


class _Part(BaseModel):
    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        json_schema_serialization_defaults_required=True,
    )


class FilePart(_Part):
    """One file, or one `table` of it that is a recording of its own; `offset_s` is added to its clock."""

    path: str
    table: str = ""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None
    offset_s: float = 0.0

    def is_same(self, other: FilePart) -> bool:
        """Whether both are one recording."""
        return (self.path, self.table) == (other.path, other.table)


class ClockPart(_Part):
    """Where the times of channels come from: a column, or a rate. Its n-th file is of the n-th recording."""

    files: tuple[FilePart, ...]
    source: str | None = None
    unit: str | None = None
    rate_hz: Annotated[float, Field(gt=0)] | None = None
    why: str = ""
    doubt: str = ""


class ChannelPart(_Part):
    """One channel: sign · scale · (source − zero) is in `unit`; zero `start` is what it shows at rest."""

    role: str
    clock: str
    source: str
    unit: str | None = None
    sign: Literal[1, -1] = 1
    scale: Annotated[float, Field(gt=0)] = 1.0
    zero: float | Literal["start"] = 0.0
    sure: bool = False
    """A person confirmed it: a size that no needle has is reported, not refused."""
    why: str = ""
    doubt: str = ""


class NotUsedPart(_Part):
    """A column that is left aside, with the reason; `clock` is that of its table."""

    source: str
    clock: str = ""
    why: Annotated[str, Field(min_length=1)]


def _with_reason(written: object) -> object:
    """A plain name, as mappings had it before reasons were kept, as an entry."""
    return {"source": written, "why": NO_REASON} if isinstance(written, str) else written


class TrialsPart(_Part):
    """How a recording is cut: at rests of the base, where a column changes, at times, or not at all."""

    at: Literal["whole", "rests", "column", "times"] = "whole"
    clock: str | None = None
    source: str | None = None
    times_s: tuple[tuple[float, float], ...] = ()
    start: Literal["relaxed", "wound"] = "relaxed"
    """How the shaft is where a trial begins; the base may stand or turn anywhere at a wound start."""
    why: str = ""
    doubt: str = ""


class LayoutPart(_Part):
    """Where `rig` comes from."""

    why: str = ""
    doubt: str = ""


class Mapping(_Part):
    """A whole mapping file."""

    format: Literal["needle-rig-import/1"] = "needle-rig-import/1"
    name: str
    clocks: dict[str, ClockPart]
    channels: tuple[ChannelPart, ...]
    trials: TrialsPart = TrialsPart()
    rate_hz: Annotated[float, Field(gt=0)] | None = None
    """Samples a second of the dataset; channels that are faster are averaged."""
    dbc: str | None = None
    """Database of a CAN bus that its logs are decoded by; without it this rig's own."""
    not_used: tuple[Annotated[NotUsedPart, BeforeValidator(_with_reason)], ...] = ()
    rig: RigPart | None = None
    layout: LayoutPart = LayoutPart()

    @property
    def lever_mm(self) -> float | None:
        """Radius at which what slides turns; None where the layout states none."""
        return None if self.rig is None else self.rig.lever_mm

    def database(self, folder: Path) -> Path | None:
        """The place of `dbc`, which is relative to `folder` as the files are."""
        return None if self.dbc is None else folder / self.dbc

    def doubts(self) -> list[str]:
        """Sentences of the lines that have a doubt: what a person is to confirm."""
        found = [f"clocks.{name}: {clock.doubt}" for name, clock in self.clocks.items() if clock.doubt]
        found += [f"{c.role} ({c.source}): {c.doubt}" for c in self.channels if c.doubt]
        if self.trials.doubt:
            found.append(f"trials: {self.trials.doubt}")
        if self.layout.doubt:
            found.append(f"layout: {self.layout.doubt}")
        return found

    def lacks(self) -> list[str]:
        """Sentences on what an import needs and no guess can give."""
        found = [
            f"{c.role} ({c.source}): its unit is not known; write `unit`, and `scale` where one count is "
            "not one of it"
            for c in self.channels
            if c.unit is None
        ]
        for name, clock in self.clocks.items():
            if clock.rate_hz is None and (clock.source is None or clock.unit is None):
                found.append(f"clocks.{name}: neither a column with its unit nor rate_hz is known; write one")
        sliding = [c for c in self.channels if c.unit and needs_lever(unit_of(c.unit))]
        if sliding and self.lever_mm is None:
            told = ", ".join(f"{c.role} in {c.unit}" for c in sliding)
            found.append(
                f"rig.lever_mm: {told}: the model turns; give the lever in mm that makes it angle or torque"
                f" (--lever): the pinion's radius, or {USUAL_LEVER_MM:g} for an axis without one"
            )
        if not any(c.role == BASE for c in self.channels):
            found.append(f"channels: no {BASE}; it drives the model")
        if all(c.role in (BASE, TIP_TORQUE) for c in self.channels):
            found.append("channels: neither torque nor an angle of the needle; there is nothing to compare")
        if self.rig is None:
            found.append(
                "rig: what the shaft looks like is not known; give a file with its layout, name the machine,"
                " or write `rig`"
            )
        return found

    def confirmed(self) -> Mapping:
        """The mapping as it is taken; its doubts become a part of the reasons."""

        def taken(why: str, doubt: str) -> dict[str, str]:
            return {"doubt": "", "why": "; ".join(filter(None, (why, doubt and f"confirmed: {doubt}")))}

        return self.model_copy(
            update={
                "clocks": {n: c.model_copy(update=taken(c.why, c.doubt)) for n, c in self.clocks.items()},
                "channels": tuple(
                    c.model_copy(update={**taken(c.why, c.doubt), "sure": c.sure or bool(c.doubt)})
                    for c in self.channels
                ),
                "trials": self.trials.model_copy(update=taken(self.trials.why, self.trials.doubt)),
                "layout": self.layout.model_copy(update=taken(self.layout.why, self.layout.doubt)),
            }
        )


def read_mapping(path: Path) -> tuple[Mapping, Places]:
    """The mapping at `path`, its files relative to its folder, and its places. Raises BadInput."""
    data, places = read_yaml(path)
    data = as_read_here(data, places, FORMAT)
    mapping = validate(Mapping, data, places)
    _check(mapping, places)
    return mapping, places


def _check(mapping: Mapping, places: Places) -> None:
    if not mapping.clocks:
        raise places.error(("clocks",), "no clock; name at least one with its files")
    counts = {name: len(clock.files) for name, clock in mapping.clocks.items()}
    for name, count in counts.items():
        if count != max(counts.values()) or not count:
            raise places.error(
                ("clocks", name, "files"),
                f"{count} files where another clock has {max(counts.values())}; list one for each recording",
            )
        clock = mapping.clocks[name]
        if clock.unit is not None:
            _unit(clock.unit, ("time",), places, ("clocks", name, "unit"))
    roles: set[str] = set()
    sensors = {s.name for s in mapping.rig.hall_sensors} if mapping.rig else None
    for k, channel in enumerate(mapping.channels):
        if channel.clock not in mapping.clocks:
            known = ", ".join(mapping.clocks)
            raise places.error(
                ("channels", k, "clock"), f"{channel.clock} is no clock of this file; it has {known}"
            )
        if channel.role in roles:
            raise places.error(("channels", k, "role"), f"{channel.role} is given twice; keep one")
        roles.add(channel.role)
        known_role = channel.role in (BASE, TORQUE, TIP_TORQUE) or sensors is None or channel.role in sensors
        if not known_role:
            choices = ", ".join([BASE, TORQUE, TIP_TORQUE, *sorted(sensors or ())])
            raise places.error(("channels", k, "role"), f"{channel.role} is none of {choices}")
        if channel.unit is not None:
            unit = _unit(channel.unit, dimensions_of(channel.role), places, ("channels", k, "unit"))
            if unit.dimension in SUMMED and channel.zero == "start":
                raise places.error(
                    ("channels", k, "zero"),
                    f"{channel.source} is a speed, whose zero no start shows; write its reading at rest or 0",
                )
    trials = mapping.trials
    if trials.at == "column" and (trials.source is None or trials.clock not in mapping.clocks):
        raise places.error(("trials",), "cut at a column: write its `source` and `clock`")
    if trials.at == "times" and not trials.times_s:
        raise places.error(("trials",), "cut at times: write `times_s`, a list of [begin, end]")
    for k, (begin, end) in enumerate(trials.times_s):
        if not begin < end:
            raise places.error(
                ("trials", "times_s", k), f"ends at {end:g} s, not after its begin {begin:g} s"
            )
    if mapping.rig is not None and mapping.rig.tip == "clamped" and TIP_TORQUE in roles:
        raise places.error(("channels",), f"{TIP_TORQUE} acts on a tip that `rig` calls clamped; remove one")
    if mapping.rig is not None:
        layout_of(mapping.rig, places)


def _unit(text: str, dimensions: tuple[str, ...], places: Places, path: tuple[str | int, ...]) -> Unit:
    unit = unit_of(text)
    if unit is None or unit.dimension not in dimensions:
        known = ", ".join(text for dimension in dimensions for text in NAMED[dimension])
        raise places.error(
            path, f"{text!r} is no unit of {' or '.join(dimensions)} known here; write one as {known}"
        )
    return unit


def dimensions_of(role: str) -> tuple[str, ...]:
    """Dimensions that a channel of this role can be recorded in."""
    return OF_TORQUE if role in (TORQUE, TIP_TORQUE) else OF_ANGLE


def write_mapping(mapping: Mapping, path: Path, folder: Path) -> None:
    """Write the mapping; its files, relative to `folder`, become relative to the folder of `path`."""
    clocks = {
        name: clock.model_copy(
            update={
                "files": tuple(
                    f.model_copy(update={"path": os.path.relpath(folder / f.path, path.parent)})
                    for f in clock.files
                )
            }
        )
        for name, clock in mapping.clocks.items()
    }
    database = mapping.database(folder)
    dbc = None if database is None else os.path.relpath(database, path.parent)
    told = mapping.model_copy(update={"clocks": clocks, "dbc": dbc}).model_dump(
        mode="json", exclude_none=False, exclude_defaults=False
    )
    path.write_text(write_yaml(_short(told)), encoding="utf-8")


def _short(told: dict[str, object]) -> dict[str, object]:
    """Without keys that say nothing; a unit that is not known stays, as null, to be filled in."""
    keep = {"unit", "format", "name"}

    def clean(value: object) -> object:
        if isinstance(value, dict):
            return {k: clean(v) for k, v in value.items() if k in keep or v not in (None, "", [], {}, False)}
        if isinstance(value, list):
            return [clean(v) for v in value]
        return value

    result = clean(told)
    assert isinstance(result, dict)
    return result


def found_file(part: FilePart, sha256: str, place: str) -> None:
    """Raise BadInput when the file is not the one that the mapping was made for."""
    if part.sha256 is not None and part.sha256 != sha256:
        raise BadInput(
            f"{place}: {part.path} is not the file that this mapping was made for (its SHA-256 differs); "
            "remove the line sha256 if this one is meant"
        )
