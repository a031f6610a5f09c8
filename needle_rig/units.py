"""Conversions between the units of files, pages and commands and the SI units used inside.

Inside: radians, newton metres, metres, seconds. At the edges: degrees, N·mm, mm.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

Number = TypeVar("Number", float, np.ndarray)

RAD_PER_DEG = math.pi / 180.0
NM_PER_NMM = 1e-3
M_PER_MM = 1e-3
N_PER_NMM_PER_100MM = 1e-2
"""A friction torque of 1 N·mm per 100 mm of needle is 0.01 N·m per metre, that is 0.01 N."""


def rad(angle_deg: Number) -> Number:
    """Degrees to radians."""
    return angle_deg * RAD_PER_DEG


def deg(angle_rad: Number) -> Number:
    """Radians to degrees."""
    return angle_rad / RAD_PER_DEG


def nm(torque_nmm: Number) -> Number:
    """N·mm to N·m."""
    return torque_nmm * NM_PER_NMM


def nmm(torque_nm: Number) -> Number:
    """N·m to N·mm."""
    return torque_nm / NM_PER_NMM


def m(length_mm: Number) -> Number:
    """Millimetres to metres."""
    return length_mm * M_PER_MM


def mm(length_m: Number) -> Number:
    """Metres to millimetres."""
    return length_m / M_PER_MM


def per_length_n(value_per_100mm: Number) -> Number:
    """N·mm (or N·mm/rad, N·mm·s/rad) per 100 mm of needle to N·m (…) per metre."""
    return value_per_100mm * N_PER_NMM_PER_100MM


def per_100mm(value_n: Number) -> Number:
    """N·m (or N·m/rad, N·m·s/rad) per metre of needle to N·mm (…) per 100 mm."""
    return value_n / N_PER_NMM_PER_100MM
