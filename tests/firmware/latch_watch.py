"""What a latch promises, judged at every millisecond from what is true and from what a person said."""

from __future__ import annotations

from typing import TYPE_CHECKING

from needle_rig.control.clearing import CLEAR_S
from needle_rig.control.compensation import ACTIVE
from needle_rig.records import COMMAND_AGE_S, TEMPORARY, DriveFault, DriveState
from needle_rig.units import nm

if TYPE_CHECKING:
    from tests.firmware.latch_world import World

LONGEST_DELAY_MS = 50
LONGEST_PAUSE_MS = 300
TICK_MS = 5
AGE_MS = round(COMMAND_AGE_S * 1e3)
MOTION_MS = LONGEST_DELAY_MS + AGE_MS + 1
"""From the end of an order to the last permitted motion: a command is on its way, then it grows old."""
SUPPLY_MS = 3 * LONGEST_DELAY_MS + 2 * TICK_MS + AGE_MS + 1
"""From a latched fault of the host to the open supply: a stop goes out, a status comes back, and the last
stop that went out until then arrives and grows old."""
WAKING_MS = round(CLEAR_S * 1e3) + LONGEST_PAUSE_MS + 2 * TICK_MS + LONGEST_DELAY_MS
"""From an order to the supply that it may close."""
SIGHT_MS = 100
"""The node's promise covers links that need no longer, there and back."""
LIMIT_NM = nm(2.0)
WORDS = {
    DriveFault.HEARTBEAT: "heartbeat",
    DriveFault.VELOCITY: "faster than its own limit",
    DriveFault.ANGLE: "turn the base back by hand",
    DriveFault.TORQUE_TRIP: "free the needle",
    DriveFault.ENCODER: "its encoder reports an error",
    DriveFault.STALL: "the motor is dead",
    DriveFault.RUNAWAY: "the encoder's scale",
    DriveFault.DIRECTION: "the wiring of motor and encoder",
    DriveFault.IDLE_MOTION: "nothing was asked of it",
    DriveFault.MASTER: "another master",
    DriveFault.EMERGENCY_STOP: "the emergency stop",
}
"""What a text says of each of the drive's latching faults, whoever found it first."""
MOVES = frozenset({"jog", "hold", "home", "compensate"})
REFERENCES = frozenset({"hall", "here"})


class Watch:
    """Raises AssertionError at the first promise that is broken; names it by its number.

    1: after a latching cause the supply is off at once, and stays off until a person cleared who saw it.
    2: nothing moves and no supply closes without an order since the last fault, stop or end.
    3: a latching fault of the host stays until a person clears it; a reference settles none of the drive's.
    4: its text names everything that latched.
    """

    def __init__(self) -> None:
        self._state = DriveState.SILENT
        self._supply = False
        self._bits = DriveFault.NONE
        self._cause_ms: int | None = None
        self._clear_ms: int | None = None
        self._seen = DriveFault.NONE
        self._order_ms: int | None = None
        self._may_move = False
        self._ended_ms = 0
        self._fault_ms = self._stop_ms = -1
        self._latched_ms: int | None = None
        self._told = DriveFault.NONE
        self._slow = False

    def ordered(self, what: str, now_ms: int, seen: DriveFault) -> None:
        """A person's order was taken; `seen` are the drive's faults that he could know."""
        if what == "clear":
            self._clear_ms, self._seen = now_ms, seen & ~TEMPORARY
            self._told = DriveFault.NONE
        if what == "clear" or (what in REFERENCES and not self._told):
            self._latched_ms = None
        if what == "clear" or what in MOVES:
            self._order_ms = now_ms
        if what in MOVES:
            self._may_move = True
        if what == "stop":
            self._stop_ms = now_ms
        if what in ("stop", "release"):
            self._end(now_ms)

    def restarted(self) -> None:
        """The node forgot everything; the host knows by its lost zero."""
        self._bits, self._cause_ms, self._state, self._supply = (
            DriveFault.NONE,
            None,
            DriveState.SILENT,
            False,
        )

    def ticked(self, world: World) -> None:
        """The host has just judged what it heard."""
        state, seen, now_ms = world.brain.state, world.measurement, world.now_ms
        if state.phase not in ACTIVE and self._may_move:
            self._end(now_ms)
        assert not world.command.enable or self._may_move, "2: the drive is enabled without an order"
        if state.fault is not None and (self._order_ms or 0) >= self._fault_ms:
            self._fault_ms = now_ms
        heard = seen.drive_age_s <= COMMAND_AGE_S
        found = seen.drive_faults & ~TEMPORARY if heard else DriveFault.NONE
        if self._clear_ms is not None and now_ms - self._clear_ms <= WAKING_MS and not found & ~self._seen:
            found = DriveFault.NONE
        if heard and seen.emergency_stop:
            found |= DriveFault.EMERGENCY_STOP
        self._told |= found
        overload = not world.broken.torque_host and abs(seen.torque_nm) > LIMIT_NM
        assert state.latched or not (found or overload), "3: a fault that was found is not kept"
        if self._latched_ms is not None:
            assert state.latched, "3: a latched fault is gone without a person"
        elif state.latched:
            self._latched_ms = now_ms
        for bit in self._told:
            assert WORDS[bit] in (state.fault or ""), f"4: the text does not name {bit!r}: {state.fault}"

    def look(self, world: World) -> None:
        """The node has just made a step."""
        guard, broken, now_ms = world.guard, world.broken, world.now_ms
        self._slow = self._slow or world.up_ms + world.down_ms + TICK_MS > SIGHT_MS
        before, self._state = self._state, world.state
        judged = before is DriveState.FAULT or (before is not DriveState.SILENT and guard.command.enable)
        causes = world.faults & ~TEMPORARY & ~self._bits
        if broken.emergency_stop:
            causes |= DriveFault.EMERGENCY_STOP
        if judged and broken.encoder:
            causes |= DriveFault.ENCODER
        if judged and broken.overload and not broken.torque_node:
            causes |= DriveFault.TORQUE_TRIP
        if causes:
            self._bits |= causes
            self._cause_ms = now_ms
            assert not guard.supply, f"1: the supply is on in spite of {causes!r}"
        if guard.supply and not self._supply:
            self._closed(now_ms)
        self._supply = bool(guard.supply)
        if self._supply and self._latched_ms is not None:
            assert now_ms - self._latched_ms <= SUPPLY_MS, "1: a latched fault leaves the supply on"
        if world.permitted:
            assert self._may_move or now_ms - self._ended_ms <= MOTION_MS, "2: motion without an order"

    def _closed(self, now_ms: int) -> None:
        order_ms = self._order_ms
        assert order_ms is not None, "2: the supply closes without an order"
        assert now_ms - order_ms <= WAKING_MS, "2: the supply closes long after the order"
        forbidden_ms = max(self._fault_ms, self._stop_ms)
        in_time = order_ms > forbidden_ms or now_ms - forbidden_ms <= MOTION_MS
        assert in_time, "2: the supply closes after a fault or a stop"
        if self._cause_ms is not None:
            assert self._clear_ms is not None, "1: a latching fault was cleared by nobody"
            assert self._clear_ms >= self._cause_ms, "1: a clear ended what came after it"
            unseen = self._bits & ~self._seen
            assert self._slow or not unseen, f"1: a clear ended {unseen!r}, which nobody had seen"
        self._bits, self._cause_ms, self._slow = DriveFault.NONE, None, False

    def _end(self, now_ms: int) -> None:
        self._may_move, self._ended_ms = False, now_ms
