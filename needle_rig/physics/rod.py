"""The rod: where the needle touches what, as coefficient arrays on a mesh.

A needle lies along x from its base. Tissue sections are cut into cells; every cell has one node at its
centre that carries the friction of the whole cell. Base, section ends, sensors and tip are nodes
of their own without tissue, so that lumped friction never shares a node with tissue and refining
the mesh moves no full-slip torque. Free spans are single elastic elements: nothing acts on them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from needle_rig.errors import BadInput
from needle_rig.numerics import Array

Indices = npt.NDArray[np.int64]

SAME_PLACE_M = 1e-9
"""Special nodes closer than this are one node."""
MOST_ELEMENTS = 2_000_000
SLACK = 1e-3
"""Stiffness within a play, over that beyond it, where the play carries nothing."""


@dataclass(frozen=True)
class Layout:
    """What lies where along the needle, from the base. Lengths in metres.

    Raises BadInput when sections overlap or leave the needle, or a sensor lies outside it.
    """

    needle_length_m: float
    tissue_sections_m: tuple[tuple[float, float], ...]
    sensor_positions_m: tuple[float, ...]
    segments: tuple[tuple[float, float, float], ...] = ()
    """(start in m, end in m, torsional rigidity over the needle's) of each stretch that differs from it."""
    tip_clamped: bool = False
    """Whether the tip is held, as in a torsion test; otherwise it is free."""

    def __post_init__(self) -> None:
        length = self.needle_length_m
        if not (math.isfinite(length) and length > 0):
            raise BadInput(f"needle length is {length * 1e3:g} mm; it must be above 0")
        before = 0.0
        for number, (start, end) in enumerate(self.tissue_sections_m, 1):
            span = f"tissue section {number} ({start * 1e3:g} to {end * 1e3:g} mm)"
            if not (math.isfinite(start) and math.isfinite(end) and end - start > SAME_PLACE_M):
                raise BadInput(f"{span} has no length; its end must lie beyond its start")
            if start < 0 or end > length + SAME_PLACE_M:
                raise BadInput(f"{span} leaves the needle, which is 0 to {length * 1e3:g} mm long")
            if start < before - SAME_PLACE_M:
                raise BadInput(
                    f"{span} overlaps or precedes the section before it, which ends at {before * 1e3:g} mm;"
                    " list sections in order from the base"
                )
            before = end
        before = 0.0
        for number, (start, end, relative) in enumerate(self.segments, 1):
            span = f"segment {number} ({start * 1e3:g} to {end * 1e3:g} mm)"
            if not (math.isfinite(start) and math.isfinite(end) and end - start > SAME_PLACE_M):
                raise BadInput(f"{span} has no length; its end must lie beyond its start")
            if start < before - SAME_PLACE_M or end > length + SAME_PLACE_M:
                raise BadInput(
                    f"{span} overlaps the one before it or leaves the needle, which is 0 to"
                    f" {length * 1e3:g} mm long; list segments in order from the base"
                )
            if not (math.isfinite(relative) and relative > 0):
                raise BadInput(f"{span} is {relative:g} times as rigid as the needle; it must be above 0")
            before = end
        for number, place in enumerate(self.sensor_positions_m, 1):
            if not 0 <= place <= length + SAME_PLACE_M:
                raise BadInput(
                    f"sensor {number} at {place * 1e3:g} mm is outside the needle,"
                    f" which is 0 to {length * 1e3:g} mm long"
                )


@dataclass(frozen=True, eq=False)
class TorqueLaw:
    """An extra torque on the nodes, for laws without coefficients.

    `law(parameters, angle_rad, rate_rad_s, time_s, position_m)` gives N·m per metre; a node receives it times
    its `weight_m` (`Rod.tissue_length_m` for a law that acts along the tissue). Positive turns the needle
    counter-clockwise. `law` is plain arithmetic and `math`: a Python or numba function (compiled here, once a
    function) or a numba cfunc of signature `kernel.laws.LAW_SIGNATURE`. Other parameters need no compilation.
    A `steady` law reads neither rate nor time: it alone does not make a rod depend on them.
    """

    law: Callable[[Any, float, float, float, float], float]
    parameters: Array
    weight_m: Array
    steady: bool = False


@dataclass(frozen=True, eq=False)
class Rod:
    """Coefficients of the discretised needle; every array has one entry a node unless said.

    The law of a node, with r the torque of the tissue on it, p the plastic anchor (the angle at which the
    tissue holds it), c the creep of the tissue, w the slip, m the state variable of the static excess, 0 to
    1, and a the age of the contact:

        θ = p + compliance · r + c,    creep_viscosity · dc/dt + creep_stiffness · c = r,
        dp/dt = dw/dt,
        limit = (1 + static_excess · m + ageing_per_decade · log10(1 + a/ageing_time)) · slip,
        r = limit · sign(dw/dt) + viscous · dw/dt while slipping, |r| ≤ limit while stuck,
        dm/dt = (exp(−(|ω|/stribeck_rate)^stribeck_exponent) − m) · (|ω| + stribeck_rate) / weakening,
        ω = dw/dt,
        da/dt = 1 − a · |ω| / weakening    (Dieterich's ageing law).

    So the static excess follows the Stribeck curve over a slip of `weakening_rad` (no dependence on mesh or
    step) and heals at rest within weakening/stribeck_rate. compliance 0 is rigid tissue; creep_stiffness and
    creep_viscosity ∞ mean no creep; an infinite slip limit holds the node. Arrays are never changed in
    place: use `dataclasses.replace`.
    """

    layout: Layout
    position_m: Array
    tissue_length_m: Array
    section: Indices
    """Number of the tissue section of each node, −1 outside tissue."""
    stiffness_nm_per_rad: Array
    """Torsional rigidity over length of each element, one entry fewer than nodes."""
    slip_plus_nm: Array
    """Kinetic slip limit for slip in the positive direction, > = 0."""
    slip_minus_nm: Array
    compliance_rad_per_nm: Array
    """Pre-sliding compliance."""
    creep_stiffness_nm_per_rad: Array
    creep_viscosity_nms_per_rad: Array
    viscous_nms_per_rad: Array
    """Torque per slip rate while slipping."""
    static_excess: Array
    """Static slip limit over the kinetic one, minus 1."""
    stribeck_rate_rad_s: float
    """Slip rate at which the static excess has fallen to 1/e."""
    stribeck_exponent: float
    """1: the static excess falls exponentially with the slip rate; 2: as a Gaussian."""
    weakening_rad: float
    """Slip over which the static excess and the age follow their laws."""
    ageing_per_decade: Array
    """Growth of the slip limit, relative to the kinetic one, for each tenfold of contact age."""
    ageing_time_s: float
    """Contact age from which ageing counts."""
    slip_per_torque: Array
    """What each N·m that the rod carries at a node adds to its slip limits, in N·m."""
    play_rad: Array
    """Play of the element behind each node, towards the tip: twist over which it is slack."""
    slack_stiffness: Array
    """Stiffness of each such element within its play, over that beyond; above 0, so that torques balance."""
    base_compliance_rad_per_nm: float
    """Series spring between the turned base and the needle."""
    base: int
    entry: int
    """First node in touch with tissue (the entry's own node, without tissue); the tip without tissue."""
    tip: int
    sensors: Indices
    laws: tuple[TorqueLaw, ...] = ()
    torque_scale: float = 1.0
    """Size of its torques over that of the needle's, to which the solver's tolerance belongs."""
    mount_compliance_rad_per_nm: float = 0.0
    """Turn of everything that touches the needle, as one body, per torque of the base."""

    @cached_property
    def coefficients(self) -> Array:
        """The node arrays, checked, as one (12, nodes) array for the solver; BadInput names a bad one."""
        nodes = len(self.position_m)
        names = (
            "slip_plus_nm",
            "slip_minus_nm",
            "compliance_rad_per_nm",
            "creep_stiffness_nm_per_rad",
            "creep_viscosity_nms_per_rad",
            "viscous_nms_per_rad",
            "static_excess",
            "ageing_per_decade",
            "position_m",
            "slip_per_torque",
            "play_rad",
            "slack_stiffness",
        )
        may_be_infinite = names[:2] + names[3:5]
        packed = np.empty((len(names), nodes))
        for row, name in enumerate(names):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.shape != (nodes,):
                raise BadInput(f"rod.{name} has shape {values.shape}; the rod has {nodes} nodes")
            good = values >= 0
            if name not in may_be_infinite:
                good &= np.isfinite(values)
            if not good.all():
                node = int(np.argmin(good))
                raise BadInput(
                    f"rod.{name} is {values[node]:g} at node {node} ({self.position_m[node] * 1e3:g} mm);"
                    " it must be a number of 0 or more"
                )
            packed[row] = values
        self._check_scalars(packed)
        return packed

    @cached_property
    def depends_on_rate(self) -> tuple[bool, bool, bool]:
        """Whether any node creeps, is viscous, has a slip limit with memory."""
        packed = self.coefficients
        creeps = np.isfinite(packed[3]) & np.isfinite(packed[4])
        return bool(creeps.any()), bool(packed[5].any()), bool(packed[6].any() or packed[7].any())

    @property
    def snaps(self) -> bool:
        """Whether the static excess breaks down faster than the needle unloads (stick-slip).

        Its torque over the weakening slip is above the stiffness of the length in front of the tissue, and
        somewhere it falls faster with the rate than viscous slip rises: where its curve is steepest by
        static_excess · slip_plus / stribeck_rate · δ xˣ e⁻ˣ, with the exponent δ and x = 1 − 1/δ.
        """
        excess = self.static_excess * np.maximum(self.slip_plus_nm, self.slip_minus_nm)
        free = self.stiffness_nm_per_rad[: max(self.entry, 1)]
        if not excess.any() or excess.sum() * float((1.0 / free).sum()) <= self.weakening_rad:
            return False
        delta = self.stribeck_exponent
        x = 1.0 - 1.0 / delta
        steepest = delta * x**x * math.exp(-x) / self.stribeck_rate_rad_s
        return bool(np.any(excess * steepest > self.viscous_nms_per_rad))

    def _check_scalars(self, packed: Array) -> None:
        nodes = packed.shape[1]
        stiffness = np.asarray(self.stiffness_nm_per_rad)
        if stiffness.shape != (nodes - 1,) or not (np.isfinite(stiffness) & (stiffness > 0)).all():
            raise BadInput(
                f"rod.stiffness_nm_per_rad must be {nodes - 1} finite numbers above 0, one for each element"
            )
        for name in ("base_compliance_rad_per_nm", "mount_compliance_rad_per_nm"):
            compliance = getattr(self, name)
            if not (math.isfinite(compliance) and compliance >= 0):
                raise BadInput(f"rod.{name} is {compliance:g}; it must be 0 or more")
        if ((packed[3] == 0) & (packed[4] == 0)).any():
            raise BadInput("creep with neither stiffness nor viscosity holds nothing; give one of them")
        has_memory = bool(packed[6].any() or packed[7].any())
        for name in ("stribeck_rate_rad_s", "stribeck_exponent", "weakening_rad", "ageing_time_s"):
            value = getattr(self, name)
            if has_memory and not (math.isfinite(value) and value > 0):
                raise BadInput(f"rod.{name} is {value:g}; with a static excess it must be above 0")


@lru_cache(maxsize=8)
def _mesh(layout: Layout, element_length_m: float) -> tuple[Array, Array, Indices]:
    """Position, length of tissue and section of each node."""
    places = _special_places(layout)
    positions: list[npt.NDArray[Any]] = []
    lengths: list[npt.NDArray[Any]] = []
    sections: list[npt.NDArray[np.int64]] = []
    for start, end in zip(places, [*places[1:], None], strict=True):
        positions.append(np.array([start]))
        lengths.append(np.zeros(1))
        sections.append(np.full(1, -1))
        if end is None:
            break
        section = _section_between(layout, start, end)
        if section >= 0:
            cells = max(1, math.ceil((end - start) / element_length_m - 1e-6))
            cell = (end - start) / cells
            positions.append(start + cell * (np.arange(cells) + 0.5))
            lengths.append(np.full(cells, cell))
            sections.append(np.full(cells, section))
    return np.concatenate(positions), np.concatenate(lengths), np.concatenate(sections)


def build_rod(
    layout: Layout, torsional_rigidity_nm2: float, friction_n: float, element_length_m: float = 0.5e-3
) -> Rod:
    """The null model on `layout`: rigid tissue with Coulomb friction `friction_n` (N·m per metre, so N).

    Every section piece between sensors is cut into equal cells no longer than `element_length_m`.
    Raises BadInput for a negative or non-finite constant or for too many elements.
    """
    if not (math.isfinite(torsional_rigidity_nm2) and torsional_rigidity_nm2 > 0):
        raise BadInput(f"torsional rigidity is {torsional_rigidity_nm2:g} N·m²; it must be above 0")
    if not (math.isfinite(friction_n) and friction_n >= 0):
        raise BadInput(f"friction is {friction_n * 100:g} N·mm per 100 mm; it must be 0 or more")
    if not (math.isfinite(element_length_m) and element_length_m > 0):
        raise BadInput(f"element length is {element_length_m * 1e3:g} mm; it must be above 0")
    in_tissue = sum(end - start for start, end in layout.tissue_sections_m)
    if in_tissue / element_length_m > MOST_ELEMENTS:
        raise BadInput(
            f"elements of {element_length_m * 1e3:g} mm cut {in_tissue * 1e3:g} mm of tissue into more than"
            f" {MOST_ELEMENTS} pieces; make them longer"
        )

    position, length, section_of = _mesh(layout, element_length_m)
    nodes = len(position)
    entry = _node_at(position, layout.tissue_sections_m[0][0]) if layout.tissue_sections_m else nodes - 1
    slip = friction_n * length
    if layout.tip_clamped:
        slip[-1] = np.inf
    return Rod(
        layout=layout,
        position_m=position,
        tissue_length_m=length,
        section=section_of,
        stiffness_nm_per_rad=torsional_rigidity_nm2
        * _relative_rigidity(layout, position)
        / np.diff(position),
        slip_plus_nm=slip,
        slip_minus_nm=slip,
        compliance_rad_per_nm=np.zeros(nodes),
        creep_stiffness_nm_per_rad=np.full(nodes, np.inf),
        creep_viscosity_nms_per_rad=np.full(nodes, np.inf),
        viscous_nms_per_rad=np.zeros(nodes),
        static_excess=np.zeros(nodes),
        stribeck_rate_rad_s=0.1,
        stribeck_exponent=2.0,
        weakening_rad=0.02,
        ageing_per_decade=np.zeros(nodes),
        ageing_time_s=1.0,
        slip_per_torque=np.zeros(nodes),
        play_rad=np.zeros(nodes),
        slack_stiffness=np.full(nodes, SLACK),
        base_compliance_rad_per_nm=0.0,
        base=0,
        entry=entry,
        tip=nodes - 1,
        sensors=np.array([_node_at(position, place) for place in layout.sensor_positions_m], dtype=np.int64),
    )


def _special_places(layout: Layout) -> list[float]:
    """Base, ends of sections and segments, sensors and tip in order, coincident ones merged."""
    wanted = [0.0, layout.needle_length_m, *layout.sensor_positions_m]
    for start, end in (*layout.tissue_sections_m, *(segment[:2] for segment in layout.segments)):
        wanted += [start, end]
    places = [0.0]
    for place in sorted(wanted):
        if place - places[-1] > SAME_PLACE_M:
            places.append(min(place, layout.needle_length_m))
    return places


def _relative_rigidity(layout: Layout, position_m: Array) -> Array:
    """Of the elements between nodes, over the needle's: (nodes - 1,). Segments end at nodes."""
    middle = 0.5 * (position_m[1:] + position_m[:-1])
    relative = np.ones(len(middle))
    for start, end, factor in layout.segments:
        relative[(middle > start) & (middle < end)] = factor
    return relative


def _section_between(layout: Layout, start: float, end: float) -> int:
    middle = 0.5 * (start + end)
    for number, (low, high) in enumerate(layout.tissue_sections_m):
        if low < middle < high:
            return number
    return -1


def _node_at(position_m: Array, place_m: float) -> int:
    # A cell's centre can lie near a special place only when the cell is shorter than SAME_PLACE_M.
    return int(np.argmin(np.abs(position_m - place_m)))
