"""Who may command the rig: one holder of a lease at a time, and nobody who asked before the last stop."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from needle_rig.errors import Aborted, BadInput

LEASE_S = 10.0
"""So long a lease lasts after its last use: longer than any pause from taking it to the first order, short
enough to wait for when its holder was killed."""
_REMEMBERED = 64


@dataclass(frozen=True)
class Claim:
    """With what a command comes: when its first byte came, on the monotonic clock, and its lease."""

    begun_s: float
    lease: str | None = None


class Taken(BadInput):
    """Somebody else commands the rig."""


class Lease:
    """While somebody holds the lease, only commands that carry it are accepted; while nobody does, all are.

    A lease lasts until it is returned, unused for LEASE_S while the rig is not `in_use`, or ended by a stop.
    """

    def __init__(self, in_use: Callable[[], bool], now_s: Callable[[], float] = time.monotonic) -> None:
        self._in_use, self._now_s = in_use, now_s
        self._held: tuple[str, str] | None = None
        self._expires_s = 0.0
        self._stopped_s = -1.0
        self._ended_by_stop: deque[str] = deque(maxlen=_REMEMBERED)

    @property
    def holder(self) -> str | None:
        """Who holds it, in the holder's own words."""
        if self._held is not None and self._now_s() > self._expires_s and not self._in_use():
            self._held = None
        return None if self._held is None else self._held[1]

    def take(self, holder: str, claim: Claim) -> str:
        """A new lease, or the claim's own once more; raises Taken, or Aborted when a stop came meanwhile."""
        self.check(claim)
        lease = claim.lease or secrets.token_hex(8)
        self._held = (lease, holder)
        self._expires_s = self._now_s() + LEASE_S
        return lease

    def check(self, claim: Claim) -> None:
        """Raise Aborted for what was asked before the last stop, Taken or BadInput for who may not."""
        if claim.begun_s <= self._stopped_s or claim.lease in self._ended_by_stop:
            raise Aborted("stopped by a person before it began; ask for it anew")
        holder = self.holder
        if self._held is not None and claim.lease == self._held[0]:
            self._expires_s = self._now_s() + LEASE_S
        elif claim.lease is not None:
            raise BadInput("this lease has ended: it was returned, or not used for too long; take a new one")
        elif holder is not None:
            raise Taken(
                f"{holder!r} commands this rig; wait until that ends ({LEASE_S:g} s after its last order at"
                " most), but anybody may stop it: needle-rig stop"
            )

    def give_back(self, claim: Claim) -> None:
        """End the claim's lease; nothing happens when it has ended already."""
        if self._held is not None and claim.lease == self._held[0]:
            self._held = None

    def stop(self) -> None:
        """Nothing that was asked for up to now may begin, with a lease or without."""
        self._stopped_s = self._now_s()
        if self._held is not None:
            self._ended_by_stop.append(self._held[0])
            self._held = None
