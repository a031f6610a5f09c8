"""Follows the runs of the rig: what the model of a run expects, for a model that this page knows."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

import numpy as np

from needle_rig.errors import NeedleRigError
from needle_rig.web.expectation import ALARM_SIGMA, BAND_SIGMA
from needle_rig.web.resident import Resident
from needle_rig.web.rig_link import RigLink

EVERY_S = 0.15
"""From one answer to the next question: an eye sees no more, and the process rests most of the time."""
NO_MODEL = '"model_sha256": null'
"""In the state of a rig whose run has no model of its own: nothing else of it is read then."""

Document = dict[str, Any]
Model = tuple[str, list[str]]
"""Path of a model file, and the folders of its effects."""


class Expecting:
    """One run at a time, from its rest on; one whose beginning was not seen is let go."""

    def __init__(self, rig: RigLink, resident: Resident, model_of: Callable[[str], Model | None]) -> None:
        """`model_of` finds the model file with this SHA-256."""
        self._rig, self._resident, self._model_of = rig, resident, model_of
        self._run = ""
        self._model: Model | None = None
        self._rest: list[list[float]] = []
        self._rows: list[list[float]] = []
        self._begun = False
        self._ahead: tuple[float, float, float] | None = None
        self._asking: asyncio.Task[None] | None = None
        self._off: list[float] = []

    async def follow(self) -> None:
        """Until it is cancelled."""
        try:
            async with self._rig.watch() as listener:
                async for text in listener.messages():
                    if NO_MODEL not in text:
                        await self._take(json.loads(text))
        finally:
            if self._asking is not None:
                self._asking.cancel()

    async def _take(self, state: Document) -> None:
        run, sensors = state.get("run"), state.get("sensors")
        if state.get("type") not in ("state", "phase") or not run or sensors is None:
            return
        if run != self._run:
            await self._begin(run, state)
        row = [state["time_s"], sensors["base_deg"], sensors["torque_nmm"], *sensors["hall_deg"]]
        if self._model is None or None in row:
            return
        if state["phase"] == "rest":
            self._rest.append(row)
        elif self._rest and (not self._rows or row[0] > self._rows[-1][0]):
            self._rows.append(row)
            self._ahead = _ahead(state)
            if self._asking is None or self._asking.done():
                self._asking = asyncio.create_task(self._ask(), name="expect")

    async def _begin(self, run: str, state: Document) -> None:
        if self._asking is not None:
            self._asking.cancel()
        self._run, self._rest, self._rows, self._begun, self._off = run, [], [], False, []
        sha256 = state.get("model_sha256")
        self._model = None if sha256 is None else await asyncio.to_thread(self._model_of, sha256)
        if self._model is not None:
            await self._resident.start()

    async def _ask(self) -> None:
        """Ask what is expected of the rows that came, until none is left."""
        while self._rows and self._model is not None:
            rows, self._rows, run = self._rows, [], self._run
            begin: Document | None = None
            if not self._begun:
                model, effects = self._model
                rest = np.mean(self._rest, axis=0).tolist()
                begin = {"model": model, "effects": effects, "rest": [self._rest[-1][0], *rest[1:]]}
            try:
                found = await self._resident.ask("expect", run=run, rows=rows, ahead=self._ahead, begin=begin)
            except NeedleRigError as error:
                self._model = None
                self._rig.tell({"type": "expected", "run": run, "refused": str(error)})
                return
            self._begun = True
            self._rig.tell(
                {"type": "expected", "run": run, "band_sigma": BAND_SIGMA, "alarm_sigma": ALARM_SIGMA} | found
            )
            await asyncio.sleep(EVERY_S)


def _ahead(state: Document) -> tuple[float, float, float] | None:
    """Waypoint, seconds until the base is there, and until it has settled; None where nothing is known."""
    left_s, waypoint_deg = state["remaining_s"], state["waypoint_deg"]
    if left_s is None or waypoint_deg is None or state["phase"] not in ("moving", "settling"):
        return None
    return (waypoint_deg, left_s, 1.0) if state["phase"] == "moving" else (waypoint_deg, 0.0, left_s + 0.1)
