"""Trials to hold a model against: measurements read from folders (needle-rig-dataset/1), and written.

dataset = read_dataset("data/practice/elastic")
for trial in dataset.trials:
    trial.trial              # what drives the model: time and base angle, SI
    trial.torque_nm          # what the model must predict, (samples,), NaN where missing
    trial.hall_rad           # (samples, sensors), NaN where missing
"""

from needle_rig.dataset.base_path import BasePath, denoised_base, encoder_noise
from needle_rig.dataset.reader import read_dataset
from needle_rig.dataset.records import (
    Dataset,
    DatasetTrial,
    Needle,
    TrialCommand,
    in_series,
)
from needle_rig.dataset.writer import write_dataset

__all__ = [
    "BasePath",
    "Dataset",
    "DatasetTrial",
    "Needle",
    "TrialCommand",
    "denoised_base",
    "encoder_noise",
    "in_series",
    "read_dataset",
    "write_dataset",
]
