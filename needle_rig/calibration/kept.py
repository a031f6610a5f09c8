"""What a calibration left on disk: `NODE.yaml`, of which the node's page was made."""

from __future__ import annotations

from pathlib import Path

from needle_rig.config.file_kinds import as_read_here
from needle_rig.config.places import read_yaml
from needle_rig.records import JsonObject

FORMAT = "needle-rig-calibration/1"


def read_calibration(path: Path) -> JsonObject:
    """The calibration at `path`. Raises BadInput with file and line, also for one of a newer needle-rig."""
    data, places = read_yaml(path)
    return as_read_here(data, places, FORMAT)
