"""Names of what jobs write, known to the server without what computes them."""

from __future__ import annotations

DIAGNOSIS = "diagnosis.yaml"
MODEL = "model.yaml"
DATASET = "dataset"
COMPARISON = "comparison.pickle"
"""A comparison with its fits, for its figures: in a folder of this server alone, which ends with it."""
DATASET_KINDS = frozenset({"import", "example"})
"""Of work whose result is a dataset."""
SCRATCH_KINDS = frozenset({"compare"})
"""Of work whose files end with the server: a pickle runs code, so none is read from a folder of runs."""
