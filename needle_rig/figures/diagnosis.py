"""A diagnosis as one picture, and as one file to send."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.figures.comparison import pictures
from needle_rig.figures.figure import Figure
from needle_rig.figures.page import heading, items, paragraph, row, shown, table, write_page
from needle_rig.version import VERSION
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.learning.diagnosis_file import KeptDiagnosis
from needle_rig.workbench.learning.history import Step, ladder
from needle_rig.workbench.selection.answer import Answer

SHOWN = 12


def ranking_figure(found: Answer) -> Figure:
    """Error left out by candidate, the best first, beside the current model and the noise."""
    rows = [r for r in found.ranking if r.held_out_error is not None][:SHOWN]
    figure = Figure(figsize=(7.5, 1.4 + 0.34 * (len(rows) + 1)), layout="constrained")
    axes = figure.subplots()
    names = ["the current model", *(r.effect for r in rows)]
    errors = [found.held_out_error_before, *(float(r.held_out_error or np.nan) for r in rows)]
    colours = ["0.6", *("#0b6e4f" if r.effect in found.effects else "#b5bcc2" for r in rows)]
    bars = axes.barh(names, errors, color=colours)
    axes.bar_label(bars, fmt=" %.2f", fontsize=8)
    axes.axvline(found.noise_floor, color="black", linewidth=1.0, linestyle="--", label="noise")
    axes.set_xscale("log")
    axes.set_xlim(0.7, 1.8 * float(np.nanmax(errors)))
    axes.invert_yaxis()
    axes.set_xlabel(f"error on {found.left_out} left out, × the noise")
    axes.set_title(f"{found.dataset}: {' and '.join(found.effects) or found.verdict}", fontsize=11)
    axes.legend(frameon=False, fontsize=8)
    return figure


@dataclass(frozen=True)
class Asked:
    """What a diagnosis was asked, as a report names it."""

    model_file: str
    """Name of the model file; empty for the null model and for a parameter set."""
    model_sha256: str
    words: tuple[str, ...]
    """The question's options."""


def write_html(
    told: Mapping[str, Any], kept: KeptDiagnosis, asked: Asked, compared: TraceComparison | None, path: Path
) -> None:
    """One file to send: what was asked of which data and model, the answer, its numbers, the pictures.

    `told` is the answer as `Diagnosed.told` has it; `compared` is where the model fails, None for settled
    values. Raises OSError.
    """
    sentence = told["sentence"]
    next_one = told["next_experiment"]
    values = told.get("model_values")
    way_on = told.get("way_on")
    write_page(
        path,
        f"What {told['model']} lacks on {told['dataset']}",
        (
            paragraph(f"{sentence[:1].upper()}{sentence[1:]}"),
            paragraph(told["errors_sentence"]),
            items("The model's values", [] if values is None else values["sentences"]),
            items("Because", [reason["sentence"] for reason in told["reasons"]]),
            heading("What was asked"),
            table(("", ""), _asked(told, kept, asked)),
            _values(told),
            _errors(ladder(kept.models[0]) if kept.models else ()),
            _ranking(told),
            *map(shown, () if compared is None else pictures(compared)),
            items("Left over", told["left_over"]),
            items("Would tell ties apart", [next_one["sentence"]] if next_one else []),
            items("How to go on", [] if way_on is None else way_on["sentences"]),
            items("Notes", told["notes"]),
        ),
    )


def _asked(told: Mapping[str, Any], kept: KeptDiagnosis, asked: Asked) -> list[str]:
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    said = [
        ("data", told["dataset"]),
        ("data, SHA-256 of what was measured", kept.sha256),
        ("model", f"{told['model']} ({asked.model_file})" if asked.model_file else told["model"]),
        *([("model file, SHA-256", asked.model_sha256)] if asked.model_sha256 else []),
        ("question", "; ".join(asked.words)),
        ("written", f"{now} by needle-rig {VERSION}"),
    ]
    return [row(name, (text,)) for name, text in said]


def _number(value: float | str | None) -> float | str:
    """Infinity is a text in a document, and what is not known is none."""
    return "–" if value is None else value


def _values(told: Mapping[str, Any]) -> str:
    """Values of all that was named, ties included."""
    named = [one for one in told["ranking"] if one["effect"] in (*told["effects"], *told["ties"])]
    rows = [
        row(
            f"{one['effect']}: {name}",
            (*(_number(v[side]) for side in ("value", "low", "high")), "" if v["unit"] == "1" else v["unit"]),
        )
        for one in named
        for name, v in one["parameters"].items()
    ]
    head = ("parameter", "value", "95 %: from", "to", "unit")
    return heading("What was found, in numbers") + table(head, rows) if rows else ""


def _errors(steps: Sequence[Step]) -> str:
    steps = [step for step in steps if step.held_out is not None]
    if not steps:
        return ""
    rows = [row("all channels / noise", [_number(step.held_out) for step in steps])]
    for name in steps[-1].channels:
        of = [step.channels.get(name) for step in steps]
        rows.append(row(name, [_number(None if one is None else one.held_out_after) for one in of]))
    return heading("Prediction error on unseen trials") + table(("", *(step.label for step in steps)), rows)


def _ranking(told: Mapping[str, Any]) -> str:
    rows = [
        row(
            one["effect"],
            (
                _number(one["held_out_error"]),
                f"{100.0 * float(one['error_removed']):.0f} %",
                one["in_favour"] + (f"; against: {one['against']}" if one["against"] else ""),
            ),
        )
        for one in told["ranking"]
    ]
    head = ("effect", "prediction error on unseen trials / noise", "error removed", "for and against")
    return heading("Ranking") + table(head, rows) if rows else ""
