from typing import Any

import numpy as np
import pytest

from needle_rig.workbench.laws.screening import dispersion
from needle_rig.workbench.laws.spline import Quadratic, Spline, covariance_about, smoothed

FAMILY = Spline(-60.0, 90.0, 16, 1.0, np.inf)
AT = np.random.default_rng(1).uniform(-60.0, 90.0, 600)
SIGMA = 0.05


def likelihood(values: Any, seed: Any = 2) -> Any:
    noisy = values + SIGMA * np.random.default_rng(seed).standard_normal(values.size)
    basis = FAMILY.basis(AT)
    return Quadratic(basis.T @ basis / SIGMA**2, basis.T @ noisy / SIGMA**2)


def test_the_basis_sums_to_one_within_and_is_constant_beyond() -> None:
    assert FAMILY.basis(AT).sum(axis=1) == pytest.approx(1.0)
    coefficients = np.arange(16.0)
    ends = FAMILY.values(coefficients, np.array([-60.0, -1e4, 90.0, 1e4]))
    assert ends[0] == pytest.approx(ends[1])
    assert ends[2] == pytest.approx(ends[3])


def test_a_value_at_the_very_end_is_inside_whatever_rounding_does() -> None:
    odd = Spline(-53.39632980791057, 95.68968183007787, 16, 1.0, 1.0)
    assert np.isfinite(odd.values(np.ones(16), np.array([odd.high, odd.low]))).all()


def test_a_curve_comes_out_of_its_noise() -> None:
    truth = 0.3 * np.sin(np.radians(2.0 * AT))
    _, gain, coefficients = smoothed(FAMILY, likelihood(truth), 0.3)
    assert gain > 1000.0
    assert np.abs(FAMILY.values(coefficients, AT) - truth).max() < 0.03


def test_noise_alone_promises_nothing() -> None:
    gains = [smoothed(FAMILY, likelihood(np.zeros_like(AT), seed), 0.3)[1] for seed in range(20)]
    assert max(gains) < 10.0


def test_a_line_is_found_smoother_than_a_wave() -> None:
    line, _, _ = smoothed(FAMILY, likelihood(AT / 90.0), 0.3)
    wave, _, _ = smoothed(FAMILY, likelihood(np.sin(np.radians(7.0 * AT))), 0.3)
    assert line.roughness < wave.roughness


def test_coefficients_of_the_prior_have_its_amplitude() -> None:
    rough = Spline(0.0, 1.0, 8, 0.5, 1e6)
    assert rough.root @ rough.root.T == pytest.approx(0.25 * np.eye(8), rel=1e-6)


def test_a_quadratic_falls_as_least_squares_says() -> None:
    quadratic = Quadratic(np.diag([2.0, 8.0]), np.array([2.0, 4.0]))
    fall, at = quadratic.fall(np.eye(2))
    assert at == pytest.approx([1.0, 0.5])
    assert fall == pytest.approx(4.0)


def test_about_other_coefficients_a_quadratic_is_the_same() -> None:
    quadratic = Quadratic(np.diag([2.0, 8.0]), np.array([2.0, 4.0]))
    moved, known = quadratic.about(np.array([1.0, 0.25]))
    fall, at = moved.fall(np.eye(2))
    assert at == pytest.approx([0.0, 0.25])
    assert known + fall == pytest.approx(4.0)


def inside(seed: Any) -> Any:
    """Share of a bump inside the 95 % band of few noisy data, with the smoothness held, and with it free."""
    random = np.random.default_rng(seed)
    at, sigma = random.uniform(-60.0, 90.0, 60), 0.2
    values = bump(at) + sigma * random.standard_normal(at.size)
    basis, everywhere = FAMILY.basis(at), np.linspace(-60.0, 90.0, 200)
    quadratic = Quadratic(basis.T @ basis / sigma**2, basis.T @ values / sigma**2)
    spline, _, coefficients = smoothed(FAMILY, quadratic, 0.3)
    held = np.linalg.inv(quadratic.G + np.linalg.inv(spline.root @ spline.root.T))
    free = covariance_about(spline, quadratic, 0.3, coefficients)
    shown = FAMILY.basis(everywhere)
    off = np.abs(shown @ coefficients - bump(everywhere))
    return [np.mean(off < 1.96 * np.sqrt(((shown @ each) * shown).sum(axis=1))) for each in (held, free)]


def bump(at: Any) -> Any:
    return 0.3 * np.exp(-(((at - 20.0) / 20.0) ** 2))


def test_a_band_over_all_smoothnesses_holds_the_curve_and_one_of_the_likeliest_alone_does_not() -> None:
    held, free = np.mean([inside(seed) for seed in range(40)], axis=0)
    assert held < 0.93 < free < 0.99


def test_data_that_are_dispersed_make_no_rougher_curve_and_a_wider_band() -> None:
    quadratic = likelihood(0.3 * np.sin(np.radians(2.0 * AT)))
    spline, gain, coefficients = smoothed(FAMILY, quadratic, 0.3)
    dispersed = quadratic.over(9.0)
    other, less, _ = smoothed(FAMILY, dispersed, 0.3)
    assert other.roughness <= spline.roughness
    assert less < gain
    spread, wider = (
        np.trace(covariance_about(spline, each, 0.3, coefficients)) for each in (quadratic, dispersed)
    )
    assert wider > 2.0 * spread


def test_a_first_curve_is_no_rougher_than_is_asked() -> None:
    wave = likelihood(0.3 * np.sin(np.radians(9.0 * AT)))
    assert smoothed(FAMILY, wave, 0.3)[0].roughness > 0.3
    assert smoothed(FAMILY, wave, 0.3, 0.3)[0].roughness <= 0.3


def test_dispersion_is_that_of_the_values_which_tell_the_curve() -> None:
    random = np.random.default_rng(3)
    residuals = [random.standard_normal(4000), 3.0 * random.standard_normal(4000)]
    told, untold = np.ones((4000, 1)), np.zeros((4000, 1))
    spread = np.array([[1e-3]])
    assert dispersion(residuals, [told, untold], spread) == pytest.approx(1.0, abs=0.06)
    assert dispersion(residuals, [untold, told], spread) == pytest.approx(9.0, abs=0.6)
    assert dispersion([0.5 * residuals[0]], [told], spread) == 1.0
