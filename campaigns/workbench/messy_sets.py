"""How often a diagnosis is right on recordings as they are: every effect, kind of noise, shape of experiment.

A block holds each effect once at five times its limit, and ten sets with nothing hidden; noises and shapes
turn from block to block, so that ten blocks give an effect each noise once, eleven each shape, 110 each
pair. The limit is that of `detection.py` in a set of the same noise and shape with nothing hidden;
multiples count from the smallest size that matters where the limit lies below it. Not asked is an effect that
does not show at thirty typical sizes, with all other parameters fitted again, or only beyond what its file
calls plausible.
"""

from __future__ import annotations

import random
import zlib
from argparse import Namespace

from campaigns.run import Campaign, Row, answered, key, markdown
from campaigns.workbench.diagnosis_sets import answer_to
from campaigns.workbench.messy_shapes import SHAPES, made
from campaigns.workbench.noise_kinds import KINDS
from campaigns.workbench.rates import HEAD, first, line, right, tied, wrong
from needle_rig.physics.library import find_effects
from needle_rig.physics.machine import NEEDLE, fitting

SEED = 880_000
NULLS = 10
"""Sets of a block with nothing hidden, one a kind of noise."""
NOISE_STEP = 3
"""By which noises turn from block to block, prime to their number; shapes by one, as theirs is another."""


def plan(given: Namespace) -> list[Row]:
    """Every dataset, block after block."""
    kinds, shapes, names = list(KINDS), list(SHAPES), sorted(fitting(find_effects(), NEEDLE))
    fixed = random.Random(0)
    fixed.shuffle(names)
    turned_noise = [k % len(kinds) for k in range(len(names))]
    turned_shape = [k % len(shapes) for k in range(len(names))]
    fixed.shuffle(turned_noise)
    fixed.shuffle(turned_shape)
    tasks: list[Row] = []
    for block in range(given.first_seed, given.first_seed + given.size):
        own = [
            {
                "effects": [name],
                "noise": kinds[(turned_noise[k] + NOISE_STEP * block) % len(kinds)],
                "shape": shapes[(turned_shape[k] + block) % len(shapes)],
                "block": block,
            }
            for k, name in enumerate(names)
        ]
        own += [
            {
                "effects": [],
                "noise": kinds[k % len(kinds)],
                "shape": shapes[(k + block) % len(shapes)],
                "block": block,
            }
            for k in range(NULLS)
        ]
        random.Random(block).shuffle(own)
        tasks += own
    return tasks


def ask(task: Row, _: Namespace) -> Row:
    given = made(task, SEED + zlib.crc32(key(task).encode()) % 1_000_000)
    return {"skipped": given} if isinstance(given, str) else answer_to(given)[0]


def table(every: list[Row], _: Namespace) -> str:
    """The figures, in Markdown, with Wilson's 95 % intervals."""
    rows = answered(every)
    hidden = [r for r in rows if r["effects"]]
    nothing = [r for r in rows if not r["effects"]]
    met = [r for r in hidden if first(r)]
    lines = [
        *HEAD,
        *line("one effect at 5 × its limit: named, or in a tie of three", "≥ 95 %", map(first, hidden)),
        *line("… or in a tie of more", "—", (r["effects"][0] in tied(r) for r in hidden)),
        *line("… a wrong name", "≤ 2 %", map(wrong, hidden)),
        *line("… said to be unknown", "—", (r["verdict"] == "unknown" for r in hidden)),
        *line("nothing hidden: none", "≥ 97 %", (r["verdict"] == "none" for r in nothing)),
        *line(
            "95 % intervals of strengths that hold the truth",
            "88 … 99 %",
            (c for r in met if r["named"] == r["effects"] for c in r["covered"]),
        ),
    ]
    for field, words in (("shape", SHAPES), ("noise", KINDS)):
        cells = []
        for word in words:
            mine = [r for r in hidden if r[field] == word]
            still = [r for r in nothing if r[field] == word]
            skipped = [r for r in every if r[field] == word and "skipped" in r]
            share = f"{sum(map(right, mine))} of {len(mine)}"
            none = f"{sum(r['verdict'] == 'none' for r in still)} of {len(still)}"
            cells.append((word, share, sum(map(wrong, mine)) or "", none, len(skipped) or ""))
        lines += ["", markdown((field, "right", "wrong names", "nothing hidden: none", "not asked"), cells)]
    lines += ["", *_misses(rows), ""]
    for why in sorted({r["skipped"] for r in every if "skipped" in r}):
        names = sorted({f"{r['effects'][0]} ({r['shape']})" for r in every if r.get("skipped") == why})
        lines.append(f"Not asked, since it {why}: {', '.join(names)}.")
    return "\n".join(lines)


def _misses(every: list[Row]) -> list[str]:
    """A line for each set whose answer is not right."""
    lines = ["| not right: hidden | noise | shape | answer |", "|---|---|---|---|"]
    for row in every:
        if right(row):
            continue
        told = " and ".join(row["named"]) or row["verdict"]
        if ties := sorted(tied(row) - set(row["named"])):
            told += f", or {', '.join(ties)}"
        told += f" ({row['verdict']}: {', '.join(row['rules'])})" if row["rules"] else ""
        lines.append(f"| {''.join(row['effects']) or 'nothing'} | {row['noise']} | {row['shape']} | {told} |")
    return lines if len(lines) > 2 else ["Every answer is right."]


CAMPAIGN = Campaign(__doc__, plan, ask, table, size=55, counts="blocks (55)")
