"""A force-torque sensor of ATI with Ethernet: torque about one axis by RDT over UDP."""

from __future__ import annotations

import math

from needle_rig.config.schema import NetFtTorque
from needle_rig.devices.device import SILENT_S, Host, TorqueSensor
from needle_rig.devices.link_clock import LinkClock
from needle_rig.errors import BadInput, RigFault
from needle_rig.units import nm
from needle_rig.wire.rdt import (
    INTERNAL_RATE_HZ,
    PAGE,
    SEQUENCE_MODULUS,
    START,
    STOP,
    SensorPage,
    decode_page,
    decode_record,
    encode_request,
)


class TorqueNetFt(TorqueSensor):
    """The newest torque that the sensor vouches for; its own sample number tells how old it is.

    Nothing counts before the sensor's page told the counts per torque.
    """

    Options = NetFtTorque

    def __init__(self, options: NetFtTorque, host: Host) -> None:
        self._options = options
        self._host = host
        self._axis = "xyz".index(options.axis)
        self._port = self.link = host.udp(options.address, options.rdt_port, self._receive)
        self._page: SensorPage | None = None
        self._clock = self._new_clock(INTERNAL_RATE_HZ)
        self._heard_s = -math.inf
        self._complaint = ""

    def complaint(self, now_s: float) -> str:  # noqa: ARG002
        """What is wrong with records that do come, for a person; empty when nothing is."""
        return self._complaint

    def age_s(self, now_s: float) -> float:
        """Time since the newest good torque was sampled; infinite before the first."""
        return self._clock.age_s(now_s)

    def needs_set_up(self, now_s: float) -> bool:
        """A sensor that was switched off and on sends nothing until it is asked."""
        return now_s - self._heard_s > SILENT_S

    async def set_up(self) -> None:
        """Read the sensor's page and ask for records. Raises RigFault when the page cannot be used."""
        content = await self._host.page(self._options.address, self._options.http_port, PAGE)
        try:
            page = decode_page(content)
        except BadInput as error:
            raise RigFault(f"Torque link ({self.link.place}): {error}") from None
        if self._page is None or page.internal_rate_hz != self._page.internal_rate_hz:
            self._clock = self._new_clock(page.internal_rate_hz)
        self._page = page
        self._port.send(encode_request(START))

    def shut_down(self) -> None:
        """Ask the sensor to be silent."""
        self._port.send(encode_request(STOP))

    def _new_clock(self, rate_hz: float) -> LinkClock:
        return LinkClock(SEQUENCE_MODULUS / rate_hz)

    def _receive(self, data: bytes, now_s: float) -> None:
        record, page, options = decode_record(data), self._page, self._options
        if record is None or page is None:
            return
        self._heard_s = now_s
        node_time_s = record.ft_sequence / page.internal_rate_hz
        torque_nm = record.torque[self._axis] / page.counts_per_nm - nm(options.offset_nmm)
        torque_nm = -torque_nm if options.reversed else torque_nm
        self._host.record("torque", (now_s, node_time_s, float(record.rdt_sequence), torque_nm))
        if record.status:
            self._complaint = f"the sensor's status is 0x{record.status:08x}; see its page or its manual"
            return
        self._complaint = ""
        if self._clock.accept(record.ft_sequence, node_time_s, now_s):
            self.torque_nm = torque_nm
