"""One trial of `hazards`, begun at a place and judged by its own figures."""

from __future__ import annotations

from campaigns.rig.hazard.cases import Case
from campaigns.rig.hazard.faults import FAULTS
from campaigns.rig.hazard.scenes import SCENES
from campaigns.rig.hazard.setups import SETUPS
from campaigns.rig.hazard.trial import Result, Trial, aftermath

SEED = 7


def reached(setup: str, scene: str, place: str, speed_deg_s: float = 20.0, after_s: float = 0.7) -> Trial:
    """A healthy rig `after_s` after it came to `place`."""
    trial = Trial(SETUPS[setup], SCENES[scene], speed_deg_s, SEED)
    while trial.place() != place:
        trial.tick()
    end_s = trial.time_s + after_s
    while trial.time_s < end_s:
        trial.tick()
    assert trial.place() == place
    return trial


def broken(trial: Trial, *breaks: tuple[str, float], left_s: float = 4.0) -> Result:
    """What becomes of it, each fault so many seconds from now."""
    injections = [(at_s, FAULTS[name].inject) for name, at_s in breaks]
    return aftermath(trial, injections, max(FAULTS[name].watch_s for name, _ in breaks), left_s)


def broken_promises(setup: str, speed_deg_s: float, result: Result, *names: str) -> list[str]:
    """The promises that `result` breaks, of a single fault or one under a passing fault."""
    breaks = tuple((name, 0.0) for name in names)
    return Case("single", setup, "run", speed_deg_s, SEED, 0, breaks).broken(result)
