"""Which kind of file a file is, by its key `format`: the kind, a slash, and the version."""

from __future__ import annotations

from needle_rig.config.places import Places
from needle_rig.records import JsonObject
from needle_rig.version import VERSION

KINDS: dict[str, tuple[str, str]] = {
    "needle-rig": ("a rig file", "name it as config, or as rig"),
    "needle-rig-dataset": ("a dataset", "name its folder as DATA"),
    "needle-rig-settled": ("a dataset of settled values", "name its folder as DATA"),
    "needle-rig-import": ("a mapping of a recording", "give it to needle-rig import"),
    "needle-rig-parameters": ("a parameter set", "name it as parameters"),
    "needle-rig-model": ("a model file", "name it as model"),
    "needle-rig-protocol": ("a protocol", "name it as protocol"),
    "needle-rig-diagnosis": ("a diagnosis", "give it to needle-rig adopt"),
    "needle-rig-watch": ("what a watch keeps of a run", "needle-rig watch reads it from beside the runs"),
    "needle-rig-calibration": ("a calibration", "needle-rig calibrate wrote it, and no command reads it"),
}
"""Each kind in words, and where a file of it is to be named."""


def check_format(data: JsonObject, places: Places, *wanted: str) -> None:
    """Raise BadInput unless `data` says that it is of one of the formats that are `wanted` here.

    One sentence stands alone then: the keys of another format would all be listed as mistakes.
    """
    given = data.get("format")
    if given in wanted:
        return
    kind, _, version = given.partition("/") if isinstance(given, str) else ("", "", "")
    same = next((w for w in wanted if w.partition("/")[0] == kind), None)
    here = " or ".join(f"{KINDS[w.partition('/')[0]][0]} ({w})" for w in wanted)
    if same is not None and version.isdecimal() and int(version) > int(same.partition("/")[2]):
        sentence = (
            f"{given} was written by a newer needle-rig than this {VERSION}, which reads {same};"
            " upgrade needle-rig, or restore a backup from before"
        )
    elif same is not None:
        sentence = (
            f"version {version!r} of {KINDS[kind][0]} is not known, this needle-rig reads {same};"
            f" take the needle-rig that wrote it, or write format: {same}"
        )
    elif kind in KINDS:
        what, where = KINDS[kind]
        sentence = f"this is {what} ({given}), not {here}; {where}"
    elif given is None:
        sentence = f"is missing; {here} is read here: write format: {wanted[0]}"
    else:
        sentence = f"{given!r} is not known; {here} is read here: write format: {wanted[0]}"
    raise places.error(("format",), sentence)
