"""What comparisons and diagnoses answer, as it stands in their JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NotRequired, TypedDict

from needle_rig.records import JsonObject


class FittedNumber(TypedDict):
    """One number of a fit."""

    value: float
    unit: str
    uncertainty: float | str | None
    """One standard deviation; None for a value that was fixed, text for infinity."""
    pull_sigma: NotRequired[float]
    """Distance from what the dataset states, in its standard deviations."""


class ChannelError(TypedDict):
    """How far a model is from one channel."""

    rmse: float
    noise: float | None
    """What noise alone makes of `rmse`."""
    in_noise_units: float | None
    """`rmse` over `noise`."""
    unit: str
    whitened: float | None
    """Root mean square of the whitened residuals: 1 for noise alone."""
    by_phase: Mapping[str, object]


class PlaceError(TypedDict):
    """How far a model is from one channel in one motion and state."""

    channel: str
    motion: str
    state: str
    direction: NotRequired[str]
    model: float
    measured: float
    error: float
    noise: float | None
    sigmas: float | None
    unit: str
    trial: NotRequired[str]
    words: str


class MisfitDocument(TypedDict):
    """What a model leaves, with its values as they stand or with those of a refit."""

    error: float | None
    """Over noise: root mean square over the channels."""
    reduced_chi2: float | None
    channels: dict[str, ChannelError]
    worst: list[PlaceError]


class ComparedNumber(TypedDict):
    """One value of a model beside that of a refit, in the unit of files; infinity is written as text."""

    name: str
    unit: str
    model: float | str | None
    """None for the null model, which has no values of its own."""
    model_uncertainty: float | str | None
    """One standard deviation; None where the model states none."""
    refit: float | str | None
    refit_uncertainty: float | str | None
    """One standard deviation; None for a value that was fixed."""
    sigmas: float | str | None
    """The refit less the model, in standard deviations of the difference."""
    fixed: bool


class CompareDocument(TypedDict):
    """What `needle-rig compare` answers.

    `channels`, `worst` and `reduced_chi2` are those of `held` where a model has values of its own, else of
    `refit`; `held_out_error` and `free_parameters` are of the refit.
    """

    dataset: str
    model: str
    held: MisfitDocument | None
    refit: MisfitDocument
    parameters: list[ComparedNumber]
    """Each value of the model beside that of the refit."""
    contradiction_p: float | None
    """p value of the distance between the two."""
    free_parameters: dict[str, FittedNumber]
    held_out_error: float | None
    noise_floor: float
    reduced_chi2: float | None
    channels: dict[str, ChannelError]
    worst: list[PlaceError]
    values: NotRequired[list[PlaceError]]
    notes: list[str]


class FTest(TypedDict):
    """Test for lack of fit, with its degrees of freedom."""

    f: float
    dof: list[int]
    p: float


class FTests(TypedDict):
    """Of the model as it was, and with what was named; None without replicates."""

    before: FTest | None
    after: FTest | None


class LeftOver(TypedDict):
    """What residuals show besides noise."""

    explained: bool
    where: list[str]


class ValuesDocument(TypedDict):
    """Whether the values of the model that is diagnosed hold, whatever its structure lacks."""

    held_error: float | None
    refit_error: float | None
    """Over noise: with the values as they stand, and with those of a refit."""
    contradiction_p: float | None
    contradict: bool
    parameters: list[ComparedNumber]
    sentences: list[str]


class WayOnDocument(TypedDict):
    """What goes on from a diagnosis that does not explain the data."""

    part: str | None
    """Effect that explains most by itself."""
    as_good: list[str]
    """Effects that explain as much."""
    channel: str | None
    """The only channel that more than noise is left in."""
    record: list[str]
    """What the recording lacks."""
    sentences: list[str]


Verdict = Literal["none", "effect", "unknown"]
"""Nothing is missing, the named effects are, or something that they are not."""


class ReasonDocument(TypedDict):
    """A rule that found something unexplained, in words."""

    rule: str
    sentence: str


class RankedValue(TypedDict):
    """A value of a candidate with its 95 % range; infinity is written as text."""

    value: float | str | None
    unit: str
    low: float | str | None
    high: float | str | None


class RankedEffect(TypedDict):
    """One candidate."""

    effect: str
    held_out_error: float | None
    error_removed: float | str | None
    parameters: dict[str, RankedValue]
    indistinguishable_from: list[str]
    separation_sigma: float | str | None
    in_favour: str
    against: str


class DiagnosisDocument(TypedDict):
    """What every form of a diagnosis says."""

    way_on: NotRequired[WayOnDocument]
    """Where the verdict is *unknown*."""

    model_values: NotRequired[ValuesDocument]
    """Of a model with values of its own, held against traces."""

    dataset: str
    model: str
    verdict: Verdict
    reasons: list[ReasonDocument]
    effects: list[str]
    ranking: list[RankedEffect]
    noise_floor: float | str | None
    held_out_error_before: float | None
    held_out_error_after: float | None
    explained_fraction: float | str | None
    """Infinity is written as text."""
    decisions: dict[str, JsonObject]
    lack_of_fit: FTests
    next_experiment: NextExperiment | None
    notes: list[str]


class DiagnoseDocument(DiagnosisDocument):
    """What `needle-rig diagnose` answers."""

    left_over: LeftOver
    policy: Mapping[str, object]


class NextExperiment(TypedDict):
    """What to do or to watch so that effects that tie come apart; one kind of data adds its own keys."""

    between: list[str]
    kind: str
    target_deg: float | None
    settle_s: float | None
    separation_sigma: float
    watch: str
    sentence: str


class NextTrial(NextExperiment):
    """A trial to be added to traces."""

    steps_deg: list[float]
    speed_deg_s: float | None
    duration_s: float


class Watched(TypedDict):
    """A value that tells effects apart, of each effect in turn."""

    separation_sigma: float
    watch: str
    sensor: str
    motion: int
    unit: str
    expected: list[float]
    turned: list[float]


class WatchedPair(Watched):
    """`Watched` between two effects."""

    between: list[str]


class NextSettled(NextExperiment):
    """A sequence whose settled values tell effects apart."""

    strategy: str
    options: Mapping[str, object]
    speed_deg_s: float | None
    sensor: str
    motion: int
    unit: str
    expected: list[float]
    turned: list[float]
    pairs: list[WatchedPair]
