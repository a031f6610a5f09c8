from __future__ import annotations

from dataclasses import replace

import pytest

from needle_rig.model import EXPERIMENT_LAYOUT
from needle_rig.physics.needle_model import NeedleModel
from tests.effects.common import LIBRARY


@pytest.fixture
def model() -> NeedleModel:
    """The null model on the experiment's layout."""
    return NeedleModel("null", EXPERIMENT_LAYOUT, 62.56e-6, 1e-3)


@pytest.fixture
def coarse(model: NeedleModel) -> NeedleModel:
    return replace(model, element_length_m=2.5e-3)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "effect" in metafunc.fixturenames:
        metafunc.parametrize("effect", [pytest.param(e, id=name) for name, e in LIBRARY.items()])
