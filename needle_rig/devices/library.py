"""Devices by their word in the rig file: the shipped ones, and files in `config/devices`."""

from __future__ import annotations

import contextlib
import importlib
import inspect
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType, ModuleType

from pydantic import BaseModel

from needle_rig.config.check import validate
from needle_rig.config.own_things import OwnFile, Source, folders_of, sources
from needle_rig.config.places import Places
from needle_rig.config.python_file import the_subclass
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
    """The nearest device of one's own called `name`. Raises BadInput when there is none."""
    try:
        source = named_source(name)
    except BadInput as unknown:
        raise BadInput(f"links.{kind}.device: {unknown}") from None
    found = device_in(source.module(), source.path)
    if not issubclass(found, KINDS[kind]):
        raise BadInput(f"links.{kind}.device: {source} is for links.{_kind_of(found)}; name one for {kind}")
    return found


def named_source(name: str) -> Source:
    """The nearest device of one's own called `name`, not read yet. Raises BadInput when there is none."""
    own = sources("devices", folders_of("devices"))
    for source in own:
        if source.name == name:
            return source
    words = [word for _, word in SHIPPED] + [source.name for source in own]
    raise BadInput(
        f"{name!r} is unknown; there are {', '.join(dict.fromkeys(words))}; one of your own is a file"
        f" config/devices/{name}.py"
    )


def load_device(path: Path) -> type[Device]:
    """The device in the file `path`. Raises BadInput with file and line when it is missing or broken."""
    file = OwnFile(path.parent.resolve() / path.name)
    return device_in(file.module(), file.path)


def _kind_of(device: type[Device]) -> str:
    return next((kind for kind, base in KINDS.items() if issubclass(device, base)), "")


def device_in(module: ModuleType, path: Path) -> type[Device]:
    """The one device that `module` defines, checked. Raises BadInput with file and line."""
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
