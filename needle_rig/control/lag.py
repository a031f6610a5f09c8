"""From the measured base torque to the lag of the needle behind its base.

Reed 2008, (5)–(7) and (9), for any layout: friction is spread evenly over the tissue length and all of the
shaft has slipped in one direction, so the torque carried at x is the base torque times the share of tissue
beyond x.
"""

from __future__ import annotations

from needle_rig.physics.rod import Layout


def tissue_length_m(layout: Layout) -> float:
    """Length of needle in tissue, metres."""
    return sum(end - start for start, end in layout.tissue_sections_m)


def effective_length_m(layout: Layout, position_m: float | None = None) -> float:
    """∫ carried torque / base torque dx from the base to `position_m` (the tip when None), metres.

    225 mm in the model geometry (7), 285 mm in the experiment geometry (9); 0 without tissue, which alone
    holds the shaft against a torque.
    """
    until = layout.needle_length_m if position_m is None else position_m
    total = tissue_length_m(layout)
    if not total:
        return 0.0
    length = 0.0
    here, before = 0.0, 0.0
    for start, end in (*layout.tissue_sections_m, (layout.needle_length_m, layout.needle_length_m)):
        share = 1.0 - before / total
        length += max(0.0, min(start, until) - here) * share
        inside = max(0.0, min(end, until) - start)
        length += inside * (share - 0.5 * inside / total)
        here, before = end, before + end - start
    return length


def lag_rad(torque_nm: float, layout: Layout, torsional_rigidity_nm2: float) -> float:
    """Lag of the tip behind the base at base torque `torque_nm`, radians: τ/JG · effective length."""
    return torque_nm / torsional_rigidity_nm2 * effective_length_m(layout)


def unwinding_rad(torque_nm: float, layout: Layout, torsional_rigidity_nm2: float) -> float:
    """Turn that brings the base torque of a wound shaft from `torque_nm` to zero, radians; signed alike.

    Masing: 2 f(τ/2) with f the virgin curve, whose slip front stands where half of the friction is used up.
    """
    total = tissue_length_m(layout)
    reached = 0.5 * total
    twist, here, before = 0.0, 0.0, 0.0
    for start, end in layout.tissue_sections_m:
        twist += (start - here) * (0.5 - before / total)
        inside = min(end - start, reached - before)
        twist += inside * (0.5 - before / total - 0.5 * inside / total)
        here, before = end, before + end - start
        if before >= reached:
            break
    return 2.0 * torque_nm / torsional_rigidity_nm2 * twist
