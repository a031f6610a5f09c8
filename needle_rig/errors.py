"""Errors that reach a person: one sentence with place, value, limit and next step."""

from __future__ import annotations


class NeedleRigError(Exception):
    """Base of all errors meant for a person; `exit_code` is what the command line exits with."""

    exit_code = 3


class BadInput(NeedleRigError):
    """An argument, a file or a value that cannot be used."""

    exit_code = 2


class RigFault(NeedleRigError):
    """A link, a sensor, the drive or a limit failed; the drive has been told to stop."""

    exit_code = 3


class Aborted(NeedleRigError):
    """A person stopped the sequence."""

    exit_code = 4


class SolverError(NeedleRigError):
    """The rod's equations could not be solved; the message names the time and the node."""

    exit_code = 3
