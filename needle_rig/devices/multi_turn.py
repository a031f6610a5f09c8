"""Hall sensors that are absolute within a turn: what those share whose turns the host counts."""

from __future__ import annotations

from needle_rig.devices.device import HallSensors, Host
from needle_rig.devices.link_clock import LinkClock
from needle_rig.wire.hall_turns import HallTurns


class MultiTurnHall(HallSensors):
    """Newest angle of every sensor; one without a usable reading keeps its value and grows old.

    After an outage the base's angle tells the turns.
    """

    def __init__(self, host: Host, clock: LinkClock) -> None:
        """`clock` is the sender's."""
        self._host = host
        self._clock = clock
        self._turns = HallTurns(host.sensors)
        self._misfit = ""
        self.angle_rad = self._turns.angle_rad

    def complaint(self, now_s: float) -> str:  # noqa: ARG002
        """What is wrong with messages that do come, for a person; empty when nothing is."""
        return self._misfit or self._turns.complaint

    def refer(self, base_rad: float) -> None:
        """The base stands at `base_rad`: sensors whose turns were lost take those nearest to it."""
        self._turns.refer(base_rad)

    def age_s(self, now_s: float) -> float:
        """Age of the oldest sensor's newest value; infinite until every sensor gave one."""
        return max(self._clock.age_s(now_s), now_s - self._turns.healthy_s)

    def _fits(self, count: int) -> bool:
        """Whether a message has an angle a sensor; when not, the complaint says so."""
        wanted = len(self._host.sensors)
        self._misfit = (
            "" if count == wanted else f"{count} sensors are sent, layout.hall_sensors has {wanted}"
        )
        return not self._misfit
