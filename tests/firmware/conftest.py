"""The nodes' C code, built once a session."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from needle_rig.firmware.build import build
from needle_rig.firmware.host import HostNodes


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the images and the host library; `NEEDLE_RIG_FIRMWARE` names one built before."""
    given = os.environ.get("NEEDLE_RIG_FIRMWARE")
    if given:
        return Path(given)
    out = tmp_path_factory.mktemp("firmware")
    build(out)
    return out


@pytest.fixture(scope="session")
def nodes(built: Path) -> HostNodes:
    return HostNodes(built)
