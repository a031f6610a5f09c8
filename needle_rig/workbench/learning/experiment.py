"""The trial that would best tell two effects apart on a rig, from what was recorded so far."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from needle_rig.config.loader import load_rig_config
from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import Protocol, save_protocol
from needle_rig.errors import BadInput
from needle_rig.physics.effect import Effect
from needle_rig.physics.machine import check_fits
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.records import JsonObject
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection.candidates import try_effect
from needle_rig.workbench.selection.design import (
    REPLICATES,
    Proposal,
    commands,
    expected_power,
    proposals,
    protocol_of,
)
from needle_rig.workbench.selection.values import spelt_sigmas

TOLD_APART_SIGMA = 2.0
"""Separation below which trials do not tell two effects apart: 95 %."""


@dataclass(frozen=True)
class Experiment:
    """What would separate two effects."""

    between: tuple[str, str]
    """As a person named them."""
    ranked: tuple[Proposal, ...]
    """The best first."""
    power_sigma: float
    """By how much `REPLICATES` trials of the best, on top of the data, separate both effects fitted again."""
    sentence: str
    better: str
    """The effect that fits better so far."""
    other: str

    @property
    def best(self) -> Proposal:
        """The trial to make."""
        return self.ranked[0]

    def protocol(self) -> Protocol:
        """The best trial, repeated, for the rig."""
        return protocol_of(self.best.command, *self.between)

    def save(self, path: Path) -> None:
        """Write the protocol file that the rig takes."""
        save_protocol(path, self.protocol(), note=self.sentence)

    def sentences(self) -> list[str]:
        """The proposal, what its repetition gives, and whether that is enough."""
        said = [
            self.sentence,
            f"{REPLICATES} such trials on top of these data: {spelt_sigmas(self.power_sigma)} between the"
            " two.",
        ]
        if self.power_sigma < TOLD_APART_SIGMA:
            said.append(
                f"At the values fitted here {self.better} and {self.other} predict the same needle; what one"
                " trial separates, fitting both again takes back."
            )
        return said

    def as_json(self, protocol: Path | None) -> JsonObject:
        """The stated form of the answer, with the file that was written."""
        return {
            "protocol": None if protocol is None else str(protocol),
            "between": list(self.between),
            "expected_separation_sigma": round(self.power_sigma, 2),
            "trials": REPLICATES,
            "duration_s": round(self.best.duration_s * REPLICATES, 1),
            "watch": self.best.watch,
            "sentence": self.sentence,
            "candidates": [
                {
                    "kind": p.command.kind,
                    "target_deg": p.command.target_deg,
                    "steps_deg": list(p.command.steps_deg),
                    "speed_deg_s": p.command.speed_deg_s,
                    "settle_s": p.command.settle_s,
                    "separation_sigma": round(p.separation_sigma, 2),
                    "duration_s": round(p.duration_s, 1),
                }
                for p in self.ranked
            ],
        }


def propose_experiment(
    dataset: Dataset,
    between: tuple[str, str],
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None = None,
    *,
    rig: Path | None = None,
    work: Work | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Experiment:
    """Fit both effects on top of `model`, and rank the trials that the rig's limits allow.

    `rig` is a rig file; without one the shipped limits hold. Raises BadInput, SolverError.
    """
    for name in between:
        if name not in library:
            raise BadInput(f"{name}: no such effect; there are {', '.join(sorted(library))}")
        check_fits(library[name], dataset.machine)
    if between[0] == between[1]:
        raise BadInput(f"between {between[0]} {between[1]}: name two different effects")
    say("fitting both effects")
    with work or Work() as at:
        at.share(library)
        baseline: Baseline = at.run(_baseline, [(dataset, model)])[0]
        at.share(baseline.problem)
        fits = []
        for tried in at.run(try_effect, [(baseline.current, name) for name in between]):
            if tried.fit is None:
                raise BadInput(f"{tried.effect} cannot be fitted to {dataset.name}; name another effect")
            fits.append(tried.fit)
        first, second = sorted(zip(fits, between, strict=True), key=lambda f: f[0].objective)
        drive = load_rig_config(rig, {}).drive
        among = commands(drive.velocity_limit_deg_s, drive.angle_limit_deg)
        say("simulating the candidates")
        both = first[0], second[0]
        simulated = at.run(proposals, [(*both, dataset.sensor_names, (command,)) for command in among])
        ranked = sorted(chain(*simulated), key=lambda proposal: -proposal.worth)
        if not ranked:
            raise BadInput("no candidate trial could be simulated with both effects")
        power_sigma: float = at.run(expected_power, [(*both, ranked[0].command, REPLICATES)])[0]
    sentence = ranked[0].sentence(first[1], second[1])
    return Experiment(between, tuple(ranked), power_sigma, sentence, first[1], second[1])


def _baseline(library: Mapping[str, type[Effect]], dataset: Dataset, model: NeedleModel | None) -> Baseline:
    return fit_baseline(dataset, model, library)
