"""Exact results for a needle in one rigid tissue section with uniform Coulomb friction.

Equations (5)–(7) and (9) are numbered as in K. B. Reed, "Compensating for Torsion Windup in Steerable
Needles", BioRob 2008. Symbols: JG torsional rigidity, υ friction torque per length (N·m per metre), L length
in tissue, l free length before it.
"""

from __future__ import annotations

import math


def virgin_base_angle_rad(
    torque_nm: float, free_length_m: float, friction_n: float, torsional_rigidity_nm2: float
) -> float:
    """Base angle that a first turn needs for `torque_nm` ≤ υL: (τ/JG)(l + τ/(2υ)); slip reaches τ/υ deep."""
    return torque_nm / torsional_rigidity_nm2 * (free_length_m + torque_nm / (2.0 * friction_n))


def virgin_torque_nm(
    base_angle_rad: float,
    free_length_m: float,
    tissue_length_m: float,
    friction_n: float,
    torsional_rigidity_nm2: float,
) -> float:
    """Base torque of a first turn by `base_angle_rad`; at most υL, where the whole needle slips."""
    # root of τ²/(2υ) + l τ − JG θ = 0, in the form without cancellation
    turn = torsional_rigidity_nm2 * base_angle_rad
    torque = 2.0 * turn / (free_length_m + math.sqrt(free_length_m**2 + 2.0 * turn / friction_n))
    return min(torque, friction_n * tissue_length_m)


def reversal_angle_rad(
    torque_change_nm: float, free_length_m: float, friction_n: float, torsional_rigidity_nm2: float
) -> float:
    """Base angle turned back since a reversal for a change of torque ≤ 2υL (Masing): 2 f(Δτ/2)."""
    return 2.0 * virgin_base_angle_rad(
        0.5 * torque_change_nm, free_length_m, friction_n, torsional_rigidity_nm2
    )


def full_slip_lag_rad(
    free_length_m: float, tissue_length_m: float, friction_n: float, torsional_rigidity_nm2: float
) -> float:
    """Lag of the tip when all slips in one direction: (7), (υL/JG)(l + L/2)."""
    torque = friction_n * tissue_length_m
    return torque / torsional_rigidity_nm2 * (free_length_m + 0.5 * tissue_length_m)


def lag_in_tissue_rad(tissue_length_m: float, friction_n: float, torsional_rigidity_nm2: float) -> float:
    """(5): the part of the lag inside the tissue, υL²/(2JG)."""
    return 0.5 * friction_n * tissue_length_m**2 / torsional_rigidity_nm2


def lag_in_free_length_rad(torque_nm: float, free_length_m: float, torsional_rigidity_nm2: float) -> float:
    """(6): twist of a free length, τl/JG."""
    return torque_nm * free_length_m / torsional_rigidity_nm2


def sections_lag_rad(
    torque_nm: float, sections_m: tuple[tuple[float, float], ...], torsional_rigidity_nm2: float
) -> float:
    """(9): lag at full slip with tissue in several sections of one friction; gaps carry what lies beyond.

    `torque_nm` is the base torque. For the experiment layout the effective length is 285 mm.
    """
    total = sum(end - start for start, end in sections_m)
    lag, left, place = 0.0, torque_nm, 0.0
    for start, end in sections_m:
        share = torque_nm * (end - start) / total
        lag += left * (start - place) + (left - 0.5 * share) * (end - start)
        left -= share
        place = end
    return lag / torsional_rigidity_nm2


def relaxed_lag_rad(tissue_length_m: float, friction_n: float, torsional_rigidity_nm2: float) -> float:
    """Lag left after full slip when the base is turned back to zero torque: υL²/(4JG)."""
    return 0.25 * friction_n * tissue_length_m**2 / torsional_rigidity_nm2


def elastic_reversal_slope_nm_per_rad(
    free_length_m: float, tissue_length_m: float, stiffness_n_per_rad: float, torsional_rigidity_nm2: float
) -> float:
    """Slope of base torque over base angle just after a reversal in elastic tissue of stiffness k per length.

    [l/JG + 1/(√(k JG) tanh(L/ℓ))]⁻¹ with ℓ = √(JG/k); k = ∞ gives the rigid slope JG/l.
    """
    compliance = free_length_m / torsional_rigidity_nm2
    if math.isfinite(stiffness_n_per_rad):
        root = math.sqrt(stiffness_n_per_rad * torsional_rigidity_nm2)
        decay = math.sqrt(torsional_rigidity_nm2 / stiffness_n_per_rad)
        compliance += 1.0 / (root * math.tanh(tissue_length_m / decay))
    return 1.0 / compliance


def slowest_relaxation_s(
    free_length_m: float, tissue_length_m: float, viscous_ns: float, torsional_rigidity_nm2: float
) -> float:
    """Slowest time constant of viscous slip with the base held: L²/(D μ²), μ tan μ = L/l, D = JG/b'."""
    ratio = tissue_length_m / free_length_m
    low, high = 0.0, 0.5 * math.pi
    for _ in range(100):
        middle = 0.5 * (low + high)
        if middle * math.tan(middle) < ratio:
            low = middle
        else:
            high = middle
    return tissue_length_m**2 * viscous_ns / (torsional_rigidity_nm2 * low**2)
