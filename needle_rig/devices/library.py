"""Devices by their word in the rig file: the shipped ones, and files in `config/devices`."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import inspect
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import MappingProxyType

from pydantic import BaseModel

from needle_rig.config.check import validate
from needle_rig.config.files import config_directories
from needle_rig.config.places import Places
from needle_rig.config.python_file import load_module, stamp_ns, the_subclass
from needle_rig.config.schema import DeviceFile, LinksSection, Section
from needle_rig.devices.device import Device, Drive, HallSensors, Host, TorqueSensor
from needle_rig.errors import BadInput, NeedleRigError

KINDS: Mapping[str, type[Device]] = MappingProxyType(
    {"drive": Drive, "torque": TorqueSensor, "hall": HallSensors}
)
"""What a rig is made of, by key below `links`."""
SHIPPED: Mapping[tuple[str, str], tuple[str, str]] = MappingProxyType(
    {
        ("drive", "node"): ("drive_can", "DriveCan"),
        ("drive", "cia402"): ("drive_cia402", "DriveCia402"),
        ("torque", "node"): ("torque_can", "TorqueCan"),
        ("torque", "netft"): ("torque_netft", "TorqueNetFt"),
        ("hall", "node"): ("hall_serial", "HallSerial"),
        ("hall", "text"): ("hall_text", "HallText"),
    }
)
"""Module and class by (kind, word); a module is imported when it is chosen."""


def make_device(links: LinksSection, kind: str, host: Host) -> Device:
    """The device that `links` names for `kind`. Raises BadInput for a file or options that cannot be used."""
    section = {"drive": links.drive, "torque": links.torque, "hall": links.hall}[kind]
    if isinstance(section, DeviceFile):
        made = find_device(kind, section.device)
        with errors_told(f"links.{kind}.device: {section.device}"):
            options = validate(made.Options, section.options, Places(f"links.{kind}"))
            return made(options, host)
    return shipped_device(kind, section.device)(section, host)


@contextmanager
def errors_told(place: str) -> Iterator[None]:
    """Raises BadInput in one sentence for what the Python of a device of one's own raises inside."""
    try:
        yield
    except NeedleRigError:
        raise
    except Exception as error:  # noqa: BLE001 any error of a user's device becomes one sentence
        raise BadInput(f"{place}: it raises {type(error).__name__}: {error}; correct the file") from None


def shipped_device(kind: str, word: str) -> type[Device]:
    """The class of a device that comes with needle-rig."""
    module, name = SHIPPED[kind, word]
    found: type[Device] = getattr(importlib.import_module(f"needle_rig.devices.{module}"), name)
    return found


def find_device(kind: str, name: str) -> type[Device]:
    """The device of the nearest file `config/devices/NAME.py`. Raises BadInput when there is none."""
    try:
        path = named_file(name)
    except BadInput as unknown:
        raise BadInput(f"links.{kind}.device: {unknown}") from None
    found = load_device(path)
    if not issubclass(found, KINDS[kind]):
        raise BadInput(f"links.{kind}.device: {path} is for links.{_kind_of(found)}; name one for {kind}")
    return found


def named_file(name: str) -> Path:
    """The nearest file `config/devices/NAME.py`. Raises BadInput when there is none."""
    folders = [folder / "devices" for folder in config_directories()]
    for folder in folders:
        if os.path.isfile(folder / f"{name}.py"):
            return folder / f"{name}.py"
    words = [word for _, word in SHIPPED]
    words += [file.stem for folder in folders for file in sorted(folder.glob("*.py"))]
    raise BadInput(
        f"{name!r} is unknown; there are {', '.join(dict.fromkeys(words))}; one of your own is a file"
        f" config/devices/{name}.py"
    )


def load_device(path: Path) -> type[Device]:
    """The device in the file `path`. Raises BadInput with file and line when it is missing or broken."""
    stamp = stamp_ns(path)
    return _load(path.resolve(), stamp)


def _kind_of(device: type[Device]) -> str:
    return next((kind for kind, base in KINDS.items() if issubclass(device, base)), "")


@cache
def _load(path: Path, stamp: int) -> type[Device]:  # noqa: ARG001 the cache's key
    module = load_module(path)
    found: type[Device] = the_subclass(module, Device, "a device", path)
    _check(found, path)
    return found


def _check(device: type[Device], path: Path) -> None:
    """Raises BadInput for what a device must have and this one lacks."""
    line = 1
    with contextlib.suppress(OSError):  # a class that was made without a line of its own
        line = inspect.getsourcelines(device)[1]
    place = f"{path}:{line}: {device.__name__}"
    if not _kind_of(device):
        raise BadInput(
            f"{place}: derive it from Drive, TorqueSensor or HallSensors of needle_rig.devices.device"
        )
    options = getattr(device, "Options", None)
    if not (isinstance(options, type) and issubclass(options, BaseModel) and issubclass(options, Section)):
        raise BadInput(f"{place} has no Options; give it a class Options(Section) with its keys")
    if "device" in options.model_fields:
        raise BadInput(f"{place}: Options has a key `device`, which stands for the file's name; rename it")
    if tuple(inspect.signature(device).parameters) != ("options", "host"):
        raise BadInput(f"{place}: it must be made by __init__(self, options, host)")
    wanted = ("age_s", "command") if issubclass(device, Drive) else ("age_s",)
    for method in wanted:
        if getattr(device, method) is getattr(_base_of(device), method):
            raise BadInput(f"{place} has no {method}; see needle_rig/devices/device.py")


def _base_of(device: type[Device]) -> type[Device]:
    return KINDS[_kind_of(device)]
