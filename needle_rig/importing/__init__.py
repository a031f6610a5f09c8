"""Recordings of any laboratory to a dataset: files, a mapping of what is what, checks.

recordings = [read_recording(Path("log.csv"))]
mapping = guess(recordings, "mine", rig, Path())
mapping.doubts()                      # what a person has to confirm
dataset = dataset_of(mapping, Path())
"""

from needle_rig.importing.assemble import dataset_of
from needle_rig.importing.guess import guess
from needle_rig.importing.mapping import Mapping, read_mapping, write_mapping
from needle_rig.importing.reader import Recordings, read_recording

__all__ = ["Mapping", "Recordings", "dataset_of", "guess", "read_mapping", "read_recording", "write_mapping"]
