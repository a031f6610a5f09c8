"""A model that a job made: its file, and what the page shows of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from needle_rig.model import SavedModel, save_model
from needle_rig.web.places import MODEL
from needle_rig.workbench.learning.history import ladder

Document = dict[str, Any]


def kept_document(saved: SavedModel, out: str) -> Document:
    """Write the model to MODEL in `out`; its values and the ladder of its errors."""
    save_model(Path(out) / MODEL, saved)
    return {
        "model": saved.model.name,
        "steps": [step.as_json() for step in ladder(saved)],
        "values": [
            {
                "name": name,
                "value": finite(value),
                "uncertainty": finite(saved.uncertainties.get(name, math.nan)),
                "unit": saved.model.info(name).unit,
            }
            for name, value in saved.model.values().items()
        ],
        "added": [effect.name() for effect in saved.model.effects],
    }


def finite(value: float) -> float | None:
    """Six digits; None for what JSON has no number for."""
    return float(f"{value:.6g}") if math.isfinite(value) else None
