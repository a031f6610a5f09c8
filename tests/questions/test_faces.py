"""Command line, page and Python are views of one record: the same fields with the same defaults."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from typing import Any

import click
import pytest

import needle_rig as nr
from needle_rig import questions
from needle_rig.notebook import questions as functions
from needle_rig.notebook.sources import export, import_recording, simulate
from needle_rig.questions.adopt import AddEffect, Adopt, Undo
from needle_rig.questions.compare import Compare
from needle_rig.questions.demo import Demo
from needle_rig.questions.diagnose import Diagnose
from needle_rig.questions.experiment import Experiment
from needle_rig.questions.export import Export
from needle_rig.questions.fields import defaults, hints
from needle_rig.questions.fit import Fit
from needle_rig.questions.identify import Identify
from needle_rig.questions.learn import Learn
from needle_rig.questions.question import Request
from needle_rig.questions.recordings import Understand
from needle_rig.questions.simulate import Simulate
from needle_rig.questions.strategies import Strategies
from needle_rig.web.desk import OF_A_MODEL, OF_DATA
from needle_rig.web.work import QUESTIONS

COMMANDS: dict[type[Request], str] = {
    Compare: "compare",
    Diagnose: "diagnose",
    Identify: "identify",
    Adopt: "adopt",
    AddEffect: "adopt",
    Undo: "adopt",
    Learn: "learn",
    Experiment: "experiment",
    Simulate: "simulate",
    Export: "export",
    Strategies: "strategies",
    Demo: "demo",
    Understand: "import",
}
NO_COMMAND = {
    (Identify, "update"): "--update FILE names the model that counts, and is one option with it",
    (Adopt, "diagnosis"): "an argument tells it from data by its name",
    (Adopt, "data"): "the same argument",
    (AddEffect, "data"): "the same argument",
    (AddEffect, "effect"): "the last word of the same argument",
    (Adopt, "name"): "the name of --out",
    (AddEffect, "name"): "the name of --out",
    (Strategies, "friction_scatter"): "--scatter-percent has its unit in its name",
    (Simulate, "noise"): "each of its numbers is an option with its unit",
    (Simulate, "name"): "the name of --out, where --name says no other",
    (Export, "form"): "each format is a flag, and one must be named",
    (Export, "folder"): "places are named from where the command is typed",
    (Demo, "draft"): "stands beside --out",
    (Understand, "name"): "the name of --out",
    (Understand, "folder"): "files are named from where the command is typed",
}
FUNCTIONS: dict[type[Request], Callable[..., Any]] = {
    Compare: functions.compare,
    Fit: functions.fit,
    Diagnose: functions.diagnose,
    Identify: functions.identify,
    Adopt: functions.adopt,
    AddEffect: functions.add_effect,
    Learn: functions.learn,
    Experiment: functions.experiment,
    Simulate: simulate,
    Export: export,
    Strategies: functions.strategies,
    Understand: import_recording,
}
OTHERWISE = {
    (Fit, "added"): "effects",
    (Fit, "effects"): "folders",
    (Simulate, "hidden"): "effects",
    (Simulate, "effects"): "folders",
    (Strategies, "hidden"): "effects",
    (Strategies, "effects"): "folders",
    (Adopt, "chosen"): "effects",
}
"""In `fit`, `simulate`, `strategies` and `adopt` what is named are effects, so that folders are called so."""
NO_ARGUMENT = {
    (Adopt, "data"): "a diagnosis of this session was of its data",
    (Adopt, "effects"): "its fits hold their effects",
    (Adopt, "name"): "save names the model",
    (AddEffect, "name"): "save names the model",
    (Learn, "draft"): "save writes it",
    (Export, "folder"): "places are named from where Python runs",
    (Understand, "name"): "the name of out",
    (Understand, "folder"): "files are named from where Python runs",
}
BESIDE = {
    functions.diagnose: {"jobs"},
    functions.learn: {"jobs"},
    functions.experiment: {"jobs"},
    functions.strategies: {"jobs"},
    import_recording: {"out", "accept_doubts"},
}
"""How it is worked, and what is done with the answer."""


def given_nothing(kind: type[Request]) -> dict[str, Any]:
    """What the question's command hands on when nothing is typed."""
    command: click.Command = importlib.import_module(f"needle_rig.cli.{COMMANDS[kind]}").command
    return command.make_context("it", [], resilient_parsing=True).params


def test_every_question_has_its_faces() -> None:
    modules = (f"needle_rig.questions.{found.name}" for found in pkgutil.iter_modules(questions.__path__))
    asked = {
        kind
        for module in map(importlib.import_module, modules)
        for kind in vars(module).values()
        if isinstance(kind, type) and issubclass(kind, Request) and hasattr(kind, "answer")
    }
    assert asked == COMMANDS.keys() | FUNCTIONS.keys()
    assert {kind for kind, _ in QUESTIONS.values()} < asked
    assert QUESTIONS.keys() - {"example"} <= {*OF_A_MODEL, *OF_DATA}


@pytest.mark.parametrize(
    ("kind", "field"), [(kind, field) for kind in COMMANDS for field in hints(kind)], ids=str
)
def test_a_field_is_an_option_with_its_default(kind: type[Request], field: str) -> None:
    if (kind, field) in NO_COMMAND:
        assert field not in given_nothing(kind).keys() - {"data"}
    else:
        assert (given_nothing(kind)[field] or None) == (defaults(kind).get(field) or None)


@pytest.mark.parametrize(
    ("kind", "field"), [(kind, field) for kind in FUNCTIONS for field in hints(kind)], ids=str
)
def test_a_field_is_an_argument_with_its_default(kind: type[Request], field: str) -> None:
    arguments = inspect.signature(FUNCTIONS[kind]).parameters
    if (kind, field) in NO_ARGUMENT:
        assert field not in arguments or field in OTHERWISE.values()
        return
    argument = arguments[OTHERWISE.get((kind, field), field)]
    default = None if argument.default is inspect.Parameter.empty else argument.default
    assert (default or None) == (defaults(kind).get(field) or None)


@pytest.mark.parametrize("kind", FUNCTIONS, ids=lambda kind: kind.__name__)
def test_a_function_asks_nothing_else(kind: type[Request]) -> None:
    named = {OTHERWISE.get((kind, field), field) for field in hints(kind)}
    more = BESIDE.get(FUNCTIONS[kind], set())
    assert inspect.signature(FUNCTIONS[kind]).parameters.keys() <= named | more


def test_what_a_request_states_too_much_lacks_or_mistakes_is_one_sentence() -> None:
    with pytest.raises(nr.BadInput, match=r"^quik: is not asked here; give effects, data, model, max_eff"):
        Diagnose.from_request({"data": ["mine"], "quik": True})
    with pytest.raises(nr.BadInput, match=r"^between: is missing; give it$"):
        Experiment.from_request({"data": ["mine"]})
    with pytest.raises(nr.BadInput, match=r"^quick is 1, not true or false$"):
        Diagnose.from_request({"data": ["mine"], "quick": 1})


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Diagnose(data="mine", max_effects=7), "max_effects 7: give 1 to 6"),
        (lambda: Diagnose(data="mine", max_effects=True), "max_effects is True, not a whole number"),
        (lambda: Strategies(friction_scatter=float("nan")), "friction_scatter nan: give 0 to 0.5"),
        (lambda: Strategies(targets_deg=(45.0, "9")), "targets_deg is '9', not a number"),  # type: ignore[arg-type]
        (lambda: Compare(data="mine", free="friction"), "free is 'friction', not a list of text"),
        (lambda: Compare(data="mine", effects=3), "effects is 3, not a list of a path"),  # type: ignore[arg-type]
        (lambda: Simulate(noise=0.1), "noise is 0.1, not a Noise or nothing"),  # type: ignore[arg-type]
        (lambda: Learn(data="mine", draft=3), "draft is 3, not text or a path or nothing"),  # type: ignore[arg-type]
    ],
)
def test_a_field_that_holds_something_else_is_one_sentence(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(nr.BadInput) as raised:
        make()
    assert str(raised.value) == said


def test_a_list_is_taken_as_what_a_field_is() -> None:
    assert Strategies(targets_deg=[45.0, 90]).targets_deg == (45.0, 90)


def test_a_page_s_request_gives_what_python_gives() -> None:
    asked = Diagnose.from_request({"data": ["mine"], "model": None, "quick": True, "effects": []})
    assert asked == Diagnose(data=["mine"], quick=True)
