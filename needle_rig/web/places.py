"""Names of what jobs write, known to the server without what computes them."""

from __future__ import annotations

DIAGNOSIS = "diagnosis.yaml"
MODEL = "model.yaml"
DATASET = "dataset"
COMPARISON = "comparison.pickle"
"""A comparison with its fits, for its figures: in a folder of this server alone, which no upload reaches."""
