"""`nr.fit`: values with what is known of them, residuals, predictions, figures."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import needle_rig as nr
from needle_rig.notebook.data import Data
from needle_rig.notebook.fit import Fit
from tests.workbench.hidden import PROTOCOL

STIFFNESS = "tissue_elasticity.stiffness_nmm_per_rad_per_100mm"
RIGIDITY = "torsional_rigidity_nmm2"


@cache
def data() -> Data:
    return nr.simulate({"tissue_elasticity": 0.35}, protocol=PROTOCOL, seed=1, name="mine", rate_hz=20.0)


@cache
def fitted() -> Fit:
    return nr.fit(data(), effects=["tissue_elasticity"])


def test_what_was_hidden_lies_in_its_interval() -> None:
    pytest.importorskip("pandas")
    params = fitted().params
    stiffness = params[STIFFNESS]
    assert stiffness.interval is not None
    assert stiffness.stderr is not None
    low, high = stiffness.interval
    assert low < 0.35 < high
    assert (high - low) / stiffness.stderr == pytest.approx(2 * 1.96, rel=0.02)
    assert stiffness.unit == "N·mm/rad per 100 mm"
    assert params.valuesdict()[RIGIDITY] == pytest.approx(62.56, rel=0.01)
    friction = params["friction_nmm_per_100mm"]
    assert friction.interval is not None
    assert friction.interval[0] < 0.1 < friction.interval[1]
    assert all(param.vary for param in params.values())
    assert stiffness.correl[RIGIDITY] == params[RIGIDITY].correl[STIFFNESS] < -0.1
    assert list(params.to_pandas()["parameter"]) == list(params)


def test_statistics_agree_with_the_residuals() -> None:
    pytest.importorskip("pandas")
    fit = fitted()
    residuals = fit.residuals()
    assert len(residuals) == fit.ndata
    assert (residuals["sigmas"] ** 2).sum() == pytest.approx(fit.chisqr)
    assert fit.redchi == pytest.approx(fit.chisqr / (fit.ndata - fit.nvarys))
    assert fit.redchi == pytest.approx(1.0, abs=0.1)
    assert np.allclose(residuals["measured"] - residuals["model"], residuals["residual"])


def test_predictions_lie_on_what_was_measured_in_degrees_and_nmm() -> None:
    pytest.importorskip("pandas")
    predicted = fitted().predict()
    assert list(predicted)[:4] == ["trial", "time_s", "base_deg", "torque_nmm"]
    first = predicted[predicted["trial"] == "01"]
    measured = data()[0].to_pandas()
    at_end = float(measured["hall_4_deg"].tail(10).mean())
    assert float(first["hall_4_deg"].iloc[-1]) == pytest.approx(at_end, abs=0.5)
    assert float(first["base_deg"].iloc[-1]) == pytest.approx(float(measured["base_deg"].iloc[-1]), abs=0.1)


def test_the_report_has_the_form_of_lmfit_s() -> None:
    report = fitted().report()
    assert "[[Fit Statistics]]" in report
    assert f"    # data points      = {fitted().ndata}" in report
    assert f"    {STIFFNESS}: 0.3" in report
    assert "[[Correlations]] (unreported correlations are < 0.100)" in report
    assert f"C({RIGIDITY}, {STIFFNESS}) = -0." in report


def test_a_value_that_is_held_stays_and_has_no_uncertainty() -> None:
    held = nr.fit(data(), ["tissue_elasticity"], {STIFFNESS: 0.3})
    assert held.params[STIFFNESS].value == pytest.approx(0.3, rel=1e-4)
    assert not held.params[STIFFNESS].vary
    assert f"{STIFFNESS}: 0.3 N·mm/rad per 100 mm (fixed)" in held.report().replace("  ", " ")
    assert held.nvarys == 2
    assert held.redchi > 3.0
    assert STIFFNESS not in held.model.params[RIGIDITY].correl


def test_a_held_value_of_the_base_moves_the_effect_s() -> None:
    held = nr.fit(data(), ["tissue_elasticity"], {RIGIDITY: 55.0})
    assert held.params[RIGIDITY].value == pytest.approx(55.0, rel=1e-3)
    assert held.params[STIFFNESS].vary
    assert held.params[STIFFNESS].value < fitted().params[STIFFNESS].value


def test_the_fitted_model_goes_on_to_be_compared_and_fitted_again() -> None:
    model = fitted().model
    held = nr.compare(data(), model)
    assert held.redchi == pytest.approx(1.0, abs=0.1)
    again = nr.fit(data(), model=model)
    assert again.params[STIFFNESS].value == pytest.approx(fitted().params[STIFFNESS].value, rel=1e-3)
    assert model.params[STIFFNESS].interval is not None


@pytest.mark.parametrize("what", ["residuals", "qq", "loop", "correlation"])
def test_figures_have_axes(what: str) -> None:
    assert fitted().plot(what).axes


def test_a_notebook_shows_values_and_picture() -> None:
    shown = fitted()._repr_html_()
    assert STIFFNESS in shown
    assert shown.count('src="data:image/png;base64,') == 1


def test_what_cannot_be_fitted_is_one_sentence() -> None:
    with pytest.raises(nr.BadInput, match=r"phlogiston: no such effect; there are"):
        nr.fit(data(), ["phlogiston"])
    with pytest.raises(nr.BadInput, match=r"stiffness: no value of the model null \+ tissue_elasticity"):
        nr.fit(data(), ["tissue_elasticity"], {"stiffness": 0.3})
    with pytest.raises(nr.BadInput, match="fixed is of type list; give values by name"):
        nr.fit(data(), ["tissue_elasticity"], [STIFFNESS])  # type: ignore[arg-type]


def test_constants_are_identified_with_what_would_give_the_others() -> None:
    pytest.importorskip("pandas")
    found = nr.identify(data())
    assert RIGIDITY in {*found.params, *found.experiments}
    assert set(found.params) | set(found.experiments) == set(found.to_pandas()["parameter"])
    assert found.misfit > 3.0
    assert "the model leaves" in found.report()
    assert found.model("rig").headline().startswith("rig:")
    assert len(found.residuals()) > 100
    with pytest.raises(nr.BadInput, match="update needs a model"):
        nr.identify(data(), update=True)
