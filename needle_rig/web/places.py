"""Names of what jobs write, known to the server without what computes them."""

from __future__ import annotations

DIAGNOSIS = "diagnosis.yaml"
MODEL = "model.yaml"
DATASET = "dataset"
