"""What the page's work finds, by kind, as types: the form of a job's `result`."""

from __future__ import annotations

from typing import NotRequired, TypedDict

from needle_rig.importing import Mapping
from needle_rig.model import ChannelErrors
from needle_rig.workbench.contest.strategies_table import StrategyOverall
from needle_rig.workbench.selection.documents import ComparedNumber, DiagnosisDocument, PlaceError

Values = list[float | None]


class Stretch(TypedDict):
    """A motion of a trial."""

    name: str
    words: str
    start_s: float
    end_s: float


class Channel(TypedDict):
    """A channel with the standard deviation of a reading."""

    name: str
    unit: str
    noise: float
    digits: int


class DrawnTrial(TypedDict):
    """A trial as measured, with what the model as it stands and refitted predicts."""

    file: str
    title: str
    time_s: list[float]
    base_deg: Values
    measured: list[Values]
    motions: list[Stretch]
    sensors: list[str]
    model: list[Values]
    refit: list[Values] | None


class DrawnTraces(TypedDict):
    """Some of the trials, the worst first, of so many."""

    channels: list[Channel]
    trials: list[DrawnTrial]
    of: int


class ComparedValue(ComparedNumber):
    """A value of the model beside that of a refit."""

    pull_sigma: float | None


class CompareResult(TypedDict):
    """Where a model fails."""

    name: str
    sentence: str
    headings: list[str]
    rows: list[list[str]]
    sentences: list[str]
    places: list[PlaceError]
    values: list[str]
    parameters: list[ComparedValue]
    verdict_on_values: str
    own: list[str]
    held_out_error: float | None
    traces: DrawnTraces | None
    notes: NotRequired[list[str]]


class DiagnoseResult(DiagnosisDocument):
    """What is missing; `candidates` are predictions by effect and file."""

    sentence: str
    errors_sentence: str
    ties: list[str]
    left_over: list[str]
    quick: bool
    candidates: dict[str, dict[str, list[Values]]]


class ModelValue(TypedDict):
    """A value of a model."""

    name: str
    value: float | None
    uncertainty: float | None
    unit: str


class ModelStep(TypedDict):
    """A step of a model's history."""

    step: str
    held_out_error: float | None
    training_error: float | None
    channels: dict[str, ChannelErrors]


class ModelResult(TypedDict):
    """A model with the ladder of its errors; None for the null model."""

    model: str | None
    steps: list[ModelStep]
    values: list[ModelValue]
    added: list[str]


class LearntLaw(TypedDict):
    """A law with its curve."""

    name: str
    words: str
    tied_with: list[str]
    experiment: str | None
    held_out_before: float | None
    held_out_after: float | None
    formula: str | None
    parameters: list[ModelValue]
    unit: str
    variable: str
    variable_unit: str
    at: Values
    value: Values
    low: Values
    high: Values
    data: Values
    halves: list[Values]


class LearnResult(TypedDict):
    """Which law is missing."""

    verdict: str
    sentence: str
    tried: int
    held_out_before: float | None
    held_out_after: float | None
    laws: list[LearntLaw]
    files: list[str]


class ShownChannel(TypedDict):
    """A mapped channel, to look at."""

    role: str
    source: str
    unit: str
    time_s: list[float]
    values: Values


class GuessResult(TypedDict):
    """What is what in recordings."""

    mapping: Mapping
    lacks: list[str]
    roles: list[str]
    shown: list[ShownChannel]


class EffectParameter(TypedDict):
    """A parameter of an effect with its plausible range."""

    name: str
    words: str
    unit: str
    off: float | None
    typical: float
    smallest: float
    lower: float
    upper: float | None
    literature: Values
    scale: str
    per: str | None
    shapes: bool


class EffectDocument(TypedDict):
    """An effect of the library."""

    name: str
    text: str
    first: str
    parameters: list[EffectParameter]
    relatives: list[str]
    redundant_with: list[str]


class EffectsDocument(TypedDict):
    """The library, and why own effects cannot be used."""

    effects: list[EffectDocument]
    broken: list[str]


class Phase(TypedDict):
    """Where a motion of the standard trial begins."""

    name: str
    start_s: float


class LessonChannel(TypedDict):
    """A channel with and without the effect."""

    name: str
    unit: str
    noise: float
    null: list[float]
    effect: list[float]
    sigmas: list[float]
    rms_sigmas: float
    most_sigmas: float


class LessonDocument(TypedDict):
    """One effect in the standard trial."""

    time_s: list[float]
    base_deg: list[float]
    phases: list[Phase]
    shaft: str
    channels: list[LessonChannel]


class SequenceMotion(TypedDict):
    """The shaft after one motion."""

    name: str
    time_s: float
    base_deg: float
    torque_nmm: float
    places_mm: list[float]
    shaft_deg: list[float]


class Sequence(TypedDict):
    """A sequence on the model itself."""

    motions: list[SequenceMotion]
    left_deg: float
    time_s: float


class StrategiesResult(TypedDict):
    """The table of strategies, and their sequences."""

    rows: list[StrategyOverall]
    target_deg: float
    needle_length_mm: float
    tissue_sections_mm: list[list[float]]
    hall_positions_mm: list[float]
    sequences: dict[str, Sequence]


RESULTS = (CompareResult, DiagnoseResult, ModelResult, LearnResult, GuessResult, StrategiesResult)
