"""Ports as people meet them: claimed for one process, and refused in one sentence."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from pathlib import Path


def claim(path: str) -> int:
    """Hold `path` for this process alone, before a byte is sent that would disturb its owner."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise OSError(error.errno, error.strerror, path) from error
    return descriptor


def claim_interface(name: str) -> int:
    """Hold the network interface `name` for this process alone among those that ask here.

    An abstract socket belongs to the interface's network namespace, and is gone with its process.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as held:
        held.bind(f"\0needle-rig/can/{name}")
        return held.detach()


def interface_reason(code: int, name: str) -> str:
    """Why a CAN interface cannot be used, and what to do, for a person; `code` is an errno."""
    if code in (errno.ENODEV, errno.ENXIO):
        return f"there is no interface {name}; is the adapter plugged in? ip link shows what is there"
    if code == errno.ENETDOWN:
        return f"{name} is down; bring it up: sudo ip link set {name} up"
    if code == errno.EADDRINUSE:
        return f"{name} is in use by another needle-rig; stop that one first"
    if code in (errno.EACCES, errno.EPERM):
        return f"no right to use {name}; a service needs RestrictAddressFamilies=AF_CAN"
    return f"cannot use {name}: {os.strerror(code)}"


def network_reason(error: OSError) -> str:
    """Why a device on the network cannot be reached, and what to do, for a person."""
    if isinstance(error, TimeoutError):
        return "nobody answers; is it on, and this its address?"
    if error.errno in (errno.EAFNOSUPPORT, errno.EACCES, errno.EPERM):
        return (
            "no right to use the network; a service gets it from its rig file:"
            " sudo needle-rig install-service, then: sudo systemctl restart needle-rig"
        )
    if isinstance(error, socket.gaierror):
        return "no such address"
    told = os.strerror(error.errno).lower() if error.errno else str(error)
    return f"{told}; is it on, and this its address? ping shows whether it is there"


def port_reason(error: OSError, path: str) -> str:
    """Why a port cannot be opened, and what to do, for a person."""
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        folder = Path(path).parent
        return f"there is no {path}; is the adapter plugged in? ls {folder} shows what is there"
    if error.errno in (errno.EWOULDBLOCK, errno.EBUSY):
        return f"{path} is in use by another program, such as another needle-rig; stop that one first"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"no right to open {path}; add this user to its group (often dialout) and log in again"
    if error.errno is None or error.errno == errno.ENOTTY:
        return f"{path} is no serial port"
    return f"cannot open {path}: {os.strerror(error.errno)}"
