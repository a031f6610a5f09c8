"""What each rule of a diagnosis is worth: it is switched off, on the same datasets, and answers are counted.

Four in five datasets are as those of `diagnosis_table`, the fifth as of `messy_sets`, with seeds that no
other campaign uses. An answer is right, wrong (it names an effect that is not there), or neither: by these it
gets better or worse. Rules that change the noise are asked of every fifth dataset. `--before` sets the
answers with all rules beside those of another commit to the same datasets.
"""

from __future__ import annotations

import argparse
import time
import traceback
import zlib
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

from scipy.stats import binomtest

from campaigns.run import Campaign, Row, answered, key, read_rows
from campaigns.workbench import diagnosis_sets, messy_shapes
from campaigns.workbench.ablation_rules import RULES, Rule, at_once, remembering, switched_off
from campaigns.workbench.diagnosis_sets import Made, relatives
from campaigns.workbench.messy_shapes import SHAPES
from campaigns.workbench.noise_kinds import KINDS
from campaigns.workbench.rates import as_physics, groups, mimicked, right, wrong
from needle_rig.physics.library import find_effects
from needle_rig.physics.machine import NEEDLE, fitting
from needle_rig.workbench.selection.diagnose import diagnose

MESSY_EVERY = 5
NOISE_EVERY = 5
MOST_CPU_S = 1500.0
"""Of one dataset: rules after that are not asked of it, and the row says so."""


def plan(given: Namespace) -> list[Row]:
    """Every dataset."""
    own = iter(diagnosis_sets.plan(5, given.first_seed))
    messy = messy_plan(given.first_seed)
    turns = (next(messy if k % MESSY_EVERY == MESSY_EVERY - 1 else own) for k in range(given.size))
    return [{"number": number, **task} for number, task in enumerate(turns)]


def messy_plan(first_block: int) -> Iterator[Row]:
    """Every effect under noises and in shapes that turn, one in five with nothing hidden."""
    names, kinds, shapes = sorted(fitting(find_effects(), NEEDLE)), list(KINDS), list(SHAPES)
    for k in range(10**6):
        turn = zlib.crc32(f"messy {first_block} {k}".encode())
        effects = [] if k % 5 == 4 else [names[turn % len(names)]]
        noise, shape = kinds[turn // 97 % len(kinds)], shapes[turn // 8641 % len(shapes)]
        yield {"kind": "messy", "effects": effects, "noise": noise, "shape": shape, "block": first_block + k}


def made(task: Row) -> Made | str:
    """A dataset with the library to search in, or why there is none."""
    if task["kind"] != "messy":
        return diagnosis_sets.made(task)
    return messy_shapes.made(task, zlib.crc32(key(task).encode()) % 1_000_000)


def judged(given: Made) -> Row:
    """What is judged of a diagnosis."""
    found = diagnose(given.dataset, given.library)
    named = found.ranking[: len(found.effects)]
    return {
        "verdict": found.verdict,
        "named": sorted(found.effects),
        "ties": {r.effect: sorted(r.indistinguishable_from) for r in named if r.indistinguishable_from},
    }


def points(task: Row, answer: Row) -> int:
    """2: right; 0: an effect is named that is not there, or it ends in an error; 1: neither."""
    if "crash" in answer:
        return 0
    row = {**task, **answer, "relatives": relatives(task.get("effects", []))}
    if task["kind"] == "impostor":
        return 0 if as_physics(row) else 2
    if task["kind"] == "removed":
        return 2 if mimicked(row) else 0 if answer["named"] else 1
    if task["kind"] == "snapping":
        return 2 if groups(row) == [{"stribeck"}] else 0 if answer["named"] else 1
    if wrong(row):
        return 0
    weak = task.get("strength") == min(diagnosis_sets.STRENGTHS)
    return 2 if right(row) or (weak and answer["verdict"] == "none") else 1


def chosen(only: str, together: bool) -> list[Rule]:
    """The rules whose name holds one of `only` (by commas), or all of them as one."""
    rules = [rule for rule in RULES if any(each in rule.name for each in only.split(","))]
    return [at_once(rules)] if together else rules


def ask(task: Row, given: Namespace) -> Row:
    """The answer to one dataset with all rules, and each that differs without one of those chosen."""
    begun = time.process_time()
    data = made(task)
    if isinstance(data, str):
        return {"skipped": data}
    with remembering() as memory:

        def answer() -> Row:
            try:
                said = judged(data)
            except Exception:  # noqa: BLE001 it is counted
                said = {"crash": traceback.format_exc(limit=-2)}
            return {**said, "points": points(task, said)}

        whole = answer()
        whole_s = time.process_time() - begun
        changed, off = {}, []
        for rule in chosen(given.rule, given.together):
            if rule.noise and task["number"] % NOISE_EVERY:
                continue
            if time.process_time() - begun > MOST_CPU_S:
                break
            with switched_off(rule, memory):
                without = answer()
            off.append(rule.name)
            if without != whole:
                changed[rule.name] = without
    return {"answer": whole, "asked": off, "changed": changed, "whole_s": round(whole_s, 1)}


def table(every: list[Row], given: Namespace) -> str:
    """Each rule with the answers that it changes; or answers beside those of another commit. Markdown."""
    rows = sorted(every, key=lambda row: row["number"])
    known = answered(rows)
    if given.before:
        return beside(known, answered(read_rows(given.before)))
    lines = [
        "| without | datasets | changed | better | worse | worse of 1,000 (95 %) |",
        "|---" * 6 + "|",
    ]
    for name in dict.fromkeys(name for r in known for name in r["asked"]):
        mine = [r for r in known if name in r["asked"]]
        changed = [r for r in mine if name in r["changed"]]
        after = [r["changed"][name]["points"] - r["answer"]["points"] for r in changed]
        worse, better = sum(d < 0 for d in after), sum(d > 0 for d in after)
        share = binomtest(worse, len(mine)).proportion_ci(method="wilson")
        between = f"{1000 * worse / len(mine):.0f} ({1000 * share.low:.0f} … {1000 * share.high:.0f})"
        counts = " | ".join(str(count or "") for count in (len(changed), better, worse))
        lines.append(f"| {name} | {len(mine)} | {counts} | {between} |")
    scores = [r["answer"]["points"] for r in known]
    lines += [
        "",
        f"With all rules: {scores.count(2)} of {len(scores)} right, {scores.count(0)} with a wrong name;"
        f" {sum(r['whole_s'] for r in known) / 3600:.1f} h of processor time.",
        "",
        "| dataset | without | answer with all rules | answer without |",
        "|---" * 4 + "|",
    ]
    for row in known:
        for name, answer in row["changed"].items():
            if answer["points"] != row["answer"]["points"]:
                lines.append(f"| {_what(row)} | {name} | {_said(row['answer'])} | {_said(answer)} |")
    return "\n".join(lines)


def beside(rows: list[Row], before: list[Row]) -> str:
    """Answers with all rules beside those of another commit to the same datasets, in Markdown."""
    old = {r["number"]: r for r in before}
    pairs = [(old[r["number"]], r) for r in rows if r["number"] in old]
    lines = ["| code | datasets | right (95 %) | wrong name | s a dataset |", "|---" * 5 + "|"]
    for side in zip(*pairs, strict=True):
        points_of = [r["answer"]["points"] for r in side]
        right, wrong, count = points_of.count(2), points_of.count(0), len(side)
        share = binomtest(right, count).proportion_ci(method="wilson")
        seconds = sum(r["whole_s"] for r in side) / count
        lines.append(
            f"| {side[0]['commit']} | {count} | {right} ({100 * share.low:.0f} … {100 * share.high:.0f} %)"
            f" | {wrong} | {seconds:.1f} |"
        )
    lines += ["", "| dataset | before | after |", "|---" * 3 + "|"]
    for one, other in pairs:
        if one["answer"] != other["answer"]:
            lines.append(f"| {_what(other)} | {_said(one['answer'])} | {_said(other['answer'])} |")
    return "\n".join(lines)


def _what(row: Row) -> str:
    hidden = "+".join(row.get("effects", ())) or row.get("impostor", "nothing")
    place = f"{row['shape']}, {row['noise']}" if "shape" in row else f"setup {row['setup']}"
    strength = f" × {row['strength']:g}" if "strength" in row else ""
    return f"{row['kind']}: {hidden}{strength}, {place}"


def _said(answer: Row) -> str:
    if "crash" in answer:
        return "ends in an error"
    ties = [f"{n} or {', '.join(t)}" if (t := answer["ties"].get(n)) else n for n in answer["named"]]
    return " and ".join(ties) or answer["verdict"]


def options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(first_seed=700)  # 700 are known; others make fresh datasets
    parser.add_argument("--rule", default="", help="only rules whose name holds one of these, by commas")
    parser.add_argument("--together", action="store_true", help="these rules switched off at once")
    parser.add_argument("--before", type=Path, help="rows of another commit to the same datasets")


CAMPAIGN = Campaign(__doc__, plan, ask, table, 300, "datasets (300)", options, rows_a_process=4)
