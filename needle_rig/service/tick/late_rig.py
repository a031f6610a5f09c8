"""A rig that need not be there yet: switched on after this computer, or plugged in later."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable

import structlog

from needle_rig.errors import RigFault
from needle_rig.records import Command, DriveState, Firmware, Measurement
from needle_rig.rig import Rig

log = structlog.get_logger("rig")

AGAIN_S = 1.0
"""From one attempt to the next; an attempt itself waits for the first readings."""


class LateRig:
    """Opens `rig` again and again until it answers; until then every link reads as dead.

    What stands in the way is reported as the complaint of its links, and once in the log.
    """

    def __init__(
        self,
        rig: Rig,
        sensors: int,
        now: Callable[[], float] = time.monotonic,
        again_s: float = AGAIN_S,
    ) -> None:
        self._rig, self._sensors, self._now, self._again_s = rig, sensors, now, again_s
        self._answers = False
        self._trouble = ""
        self._opening: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Try once, and go on trying in the background."""
        if not await self._try():
            self._opening = asyncio.create_task(self._keep_trying(), name="open rig")

    def read(self) -> Measurement:
        """See `Rig.read`."""
        if self._answers:
            return self._rig.read()
        return Measurement(
            time_s=self._now(),
            base_angle_rad=math.nan,
            torque_nm=math.nan,
            hall_rad=(math.nan,) * self._sensors,
            drive_state=DriveState.SILENT,
            torque_complaint=self._trouble,
            hall_complaint=self._trouble,
            referenced=False,
            supply_on=False,
        )

    def write(self, command: Command) -> None:
        """See `Rig.write`."""
        if self._answers:
            self._rig.write(command)

    def firmware(self) -> dict[str, Firmware]:
        """See `Rig.firmware`; also of a rig that does not answer: a node may be why."""
        return self._rig.firmware()

    async def close(self) -> None:
        """See `Rig.close`."""
        if self._opening is not None:
            self._opening.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._opening
            self._opening = None
        await self._rig.close()

    async def _keep_trying(self) -> None:
        while True:
            await asyncio.sleep(self._again_s)
            try:
                if await self._try():
                    log.info("the rig answers")
                    return
            except Exception as error:  # noqa: BLE001 - told, and tried again: nobody waits for this task
                self._tell(f"a defect: {error!r}")

    async def _try(self) -> bool:
        try:
            await self._rig.open()
        except RigFault as fault:
            self._tell(str(fault))
            return False
        self._answers = True
        return True

    def _tell(self, trouble: str) -> None:
        if trouble != self._trouble:
            log.warning("no rig yet", reason=trouble)
        self._trouble = trouble
