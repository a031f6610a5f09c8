"""The figures as Markdown."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from campaigns.rig.hazard.campaign import Found, Lame
from campaigns.rig.hazard.faults import FAULTS
from campaigns.rig.hazard.setups import BOUND_DEG, DISAGREEMENT_DEG, SETUPS

HEAD = f"""\
Virtual time, the host's production code. *own*: the nodes' C, with the guard of motion in the drive node.
*cia402*: the production driver and the drive's twin; the host alone watches its motion.

- *commanded*: farthest that the true base came outside all that the host had commanded.
- *asked*: farthest outside the hull of where it stood at the order and of all its waypoints.
- *bound*: {BOUND_DEG:g}° for a single fault.
  *l*: {DISAGREEMENT_DEG:g}° for an encoder that lies by little. Only the host sees it, once encoder, torque
  and Hall angles disagree by 8° + 5 % + half the twist.
  *d*: derived, for a drive without a guard of motion: 1.5° + 60 ms × speed + v × (oldest answer + two ticks
  + 12 ms of the motor) + v²/(2 × 2000°/s²), v being the motor's own speed.
- *off*: longest from the fault until the motor stood and was off for good.
- *unseen*: share of trials in which nobody noticed, such as of a fault that changes nothing where it falls.
- *woken*: trials in which the supply came on after a latching fault without a clear; must be none.
- *moved*: trials in which something ran or moved without an order; must be none.
"""
WHY = {
    "supply relay welded": (
        "beside a shorted power stage nothing that the host or a node commands ends the motion. The emergency"
        " stop must open the motor's own line."
    ),
    "encoder reads 0.7": (
        "from the first motion on, before the shaft's spring is known. It lies by 0.3 of the turn in which"
        " the needle winds up. It is named once encoder and Hall angle are apart by the limit of"
        " disagreement and by the twist that the tissue before the first sensor may hold."
    ),
    "another master, same counter": (
        "the node takes them for the host's until five of the host's own are out of sequence, which takes"
        " 0.1 s at 50 Hz. The other master wants 60°/s."
    ),
}
"""What limits the guards where a promise is known to be broken."""
_COLUMNS = (
    "trials | commanded ° worst, median | asked ° worst, median | bound ° | named | unseen | off ms | no end"
    " | woken | moved |"
)


@dataclass(frozen=True)
class Group:
    """Trials that stand in one row."""

    found: list[Found]

    def cells(self) -> str:
        """Everything but the row's name."""
        results = [one.result for one in self.found]
        commanded = [result.commanded_deg for result in results]
        asked = [result.asked_deg for result in results]
        named = Counter(result.name for result in results if result.name)
        off = [result.off_ms for result in results if result.off_ms is not None and result.name]
        cells = [
            str(len(results)),
            f"{max(commanded):.2f}, {statistics.median(commanded):.2f}",
            f"{max(asked):.2f}, {statistics.median(asked):.2f}",
            self._bound(),
            ", ".join(f"{name} {count}" for name, count in named.most_common()),
            f"{1.0 - named.total() / len(results):.2f}",
            f"{max(off):.0f}" if off else "",
            *(str(n) if n else "" for n in (self._endless, self._sum("woken"), self._sum("moved"))),
        ]
        return " | ".join(cells) + " |"

    @property
    def _endless(self) -> int:
        return sum(not one.result.ended for one in self.found)

    def _sum(self, what: str) -> int:
        return sum(getattr(one.result, what) > 0 for one in self.found)

    def _bound(self) -> str:
        """The bound of the trial that used most of its own."""
        nearest = max(
            self.found, key=lambda f: max(f.result.commanded_deg, f.result.asked_deg) / f.case.bound_deg
        )
        bound_deg = nearest.case.bound_deg
        derived = bound_deg not in (BOUND_DEG, DISAGREEMENT_DEG)
        return f"{bound_deg:.1f}" + ("d" if derived else "l" if bound_deg > BOUND_DEG else "")


def table(title: str, heads: str, found: Iterable[Found], row_of: Callable[[Found], str]) -> list[str]:
    """One table, its rows in the order in which they are met."""
    rows: dict[str, list[Found]] = {}
    for one in found:
        rows.setdefault(row_of(one), []).append(one)
    if not rows:
        return []
    lines = ["", f"## {title}", "", f"| {heads} | {_COLUMNS}"]
    lines.append("|---" * (lines[-1].count("|") - 1) + "|")
    lines += [f"| {name} | {Group(group).cells()}" for name, group in rows.items()]
    return lines


def report(found: list[Found], lame: list[Lame], head: str) -> str:
    """All tables, and each trial that broke a promise."""
    order = {name: n for n, name in enumerate(FAULTS)}
    found = sorted(found, key=lambda f: (order[f.case.breaks[-1][0]], f.case.setup.startswith("c")))
    by_kind = {
        kind: [f for f in found if f.case.kind == kind]
        for kind in ("single", "under", "slow", "pair", "latch")
    }
    lines = [HEAD, head]
    fault, rig = lambda f: f"{f.case.breaks[-1][0]} | {drive_of(f)}", "fault | rig"
    lines += table("One fault", rig, by_kind["single"], fault)
    lines += table("Under a passing fault of another kind, 0.3 s old", rig, by_kind["under"], fault)
    lines += table(
        "Slow faults",
        "fault, scene | rig",
        by_kind["slow"],
        lambda f: f"{f.case.breaks[-1][0]}, {f.case.scene} | {drive_of(f)}",
    )
    lines += table("Two faults, up to 0.8 s apart", "rig", by_kind["pair"], drive_of)
    lines += table("A latching fault under a passing one", rig, by_kind["latch"], fault)
    everything = [f for f in found if f.case.kind != "pair"]
    lines += table(
        "By setup",
        "setup",
        sorted(everything, key=lambda f: list(SETUPS).index(f.case.setup)),
        lambda f: f.case.setup,
    )
    lines += table(
        "By place", "place", sorted(everything, key=lambda f: f.case.place), lambda f: f.case.place
    )
    if lame:
        lines += ["", "## Healthy rigs that stopped by themselves", ""]
        counts = Counter(f"{one.setup} at {one.speed_deg_s:g}°/s: {one.fault}" for one in lame)
        lines += [f"- {text} ({count})" for text, count in counts.items()]
    broken = [(f, why) for f in found if (why := f.case.broken(f.result))]
    pairs_far = sum(
        max(f.result.commanded_deg, f.result.asked_deg) > f.case.bound_deg for f in by_kind["pair"]
    )
    lines += ["", "## Broken", ""]
    lines += [f"{len(broken)} of {len(found)} trials; {pairs_far} pairs went beyond 15° and ended or not."]
    lines += ['Again, with a trace: `hazards --only \'{"trial": "LINE"}\'`.', *_reasons(broken)]
    lines += [f"- `{f.case.text}`: {'; '.join(why)} ({f.result.name or 'not noticed'})" for f, why in broken]
    return "\n".join(lines)


def _reasons(broken: list[tuple[Found, list[str]]]) -> list[str]:
    """Why, for the faults of which it is known."""
    told = [
        f"- {fault}: {reason}"
        for fault, reason in WHY.items()
        if any(fault in found.case.text for found, _ in broken)
    ]
    return ["", *told, ""]


def drive_of(found: Found) -> str:
    """Its kind of drive."""
    return SETUPS[found.case.setup].drive
