"""What the page's server answers, as types, from which `scripts/web_types.py` makes those of the browser."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

from needle_rig.web.jobs import State


class Named(TypedDict):
    """A key with the name that people read."""

    key: str
    name: str


class SourceDocument(Named):
    """Data that can be chosen."""

    kind: Literal["dataset", "run", "published", "upload", "recording", "model", "imported", "example"]


class StrategyDocument(TypedDict):
    """A strategy with what it does, in a sentence."""

    name: str
    text: str


class JobDocument(Named):
    """A piece of work, without its result; the time left is that of the present step."""

    kind: str
    data: list[Named]
    model: Named | None
    asked: dict[str, Any]
    state: State
    step: str
    done: int
    total: int
    begun_utc_s: float
    asked_utc_s: float
    elapsed_s: float
    left_s: float | None
    added: list[str]
    error: str


class AnsweredJob(JobDocument):
    """A piece of work with what it found; its form is that of its kind."""

    result: dict[str, Any] | None


class JobsDocument(TypedDict):
    """What runs, and what was asked last."""

    jobs: list[JobDocument]


class BegunJob(TypedDict):
    """The key of the work that answers a question."""

    job: str


class AboutDocument(TypedDict):
    """What can be chosen."""

    data: list[SourceDocument]
    machines: list[Named]
    strategies: list[StrategyDocument]
    models: list[JobDocument]
    rig_model: Named | None
    parameters: list[str]
    runs: str
    unkept: str


class RigModelDocument(TypedDict):
    """The model that orders plan with where they name none."""

    rig_model: Named | None


class SessionDocument(TypedDict):
    """Whether this browser may only watch."""

    watches: bool


class OpenedSession(SessionDocument):
    """The page's half of the session, too."""

    page: str


class WatchDocument(TypedDict):
    """What a person should know besides the state; empty where there is nothing."""

    contradiction: str
    version: str


class NotesDocument(TypedDict):
    """What people add to a run."""

    tags: list[str]
    note: str


class RunDocument(NotesDocument):
    """One recorded run as it is listed."""

    name: str
    simulated: bool | None
    started_utc: str
    target_deg: float | None
    strategy: str
    parameters: str
    status: str
    duration_s: float
    tip_lag_deg: float | None


class RunsDocument(TypedDict):
    """Some of the recorded runs; how many there are, and how many are still to be read."""

    runs: list[RunDocument]
    of: int
    indexing: int


class JudgedRun(TypedDict):
    """A run of the trends."""

    run: str
    started_utc: str


class UnjudgedRun(TypedDict):
    """A run that says nothing, and why."""

    run: str
    why: str


class TrendChart(TypedDict):
    """One parameter over the runs."""

    name: str
    unit: str
    values: list[float | None]
    uncertainties: list[float | None]
    range: list[float | None] | None
    """Lowest and highest of the reference period; None before it is over."""
    since: str | None
    """First run of a change."""


class TrendsDocument(TypedDict):
    """What the watch over the runs found."""

    watched: bool
    sentences: list[str]
    alarm: bool
    reference: int
    judged: int
    runs: list[JudgedRun]
    not_judged: list[UnjudgedRun]
    charts: list[TrendChart]


class EstimateDocument(TypedDict):
    """Matrix from readings to the angle along the shaft."""

    places_mm: list[float]
    gain_deg: list[list[float]]
    deviation_deg: list[float]


class BegunUpload(TypedDict):
    """The key of a place for files."""

    upload: str


class TakenFile(TypedDict):
    """What an upload holds so far."""

    files: int
    data: int
    model: bool


class ErrorDocument(TypedDict):
    """A refusal."""

    error: str
    exit_code: int


class EmptyDocument(TypedDict):
    """Done, and nothing to say."""
