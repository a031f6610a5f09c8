"""needle-rig import: recordings of any laboratory, as a dataset."""

from __future__ import annotations

import os
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.physics.machine import MACHINES, NEEDLE

if TYPE_CHECKING:
    from needle_rig.importing import Mapping
    from needle_rig.questions.recordings import Understood

PICTURE = "import.png"
OTHERS = [name for name in MACHINES if name != NEEDLE]


@click.command("import")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE…")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Dataset to write; must be new.")
@click.option("--guess", "guessing", is_flag=True, help="Propose the mapping from the files themselves.")
@click.option(
    "--layout",
    type=click.Path(path_type=Path),
    help="What the shaft looks like: a YAML file with the keys of `rig`, a rig file, or a dataset.",
)
@click.option(
    "--dbc",
    type=click.Path(path_type=Path),
    help="Database of the CAN bus that logs among FILE are of; without it this rig's own.",
)
@click.option(
    "--machine",
    type=click.Choice(OTHERS),
    help="What was recorded, if no needle: a layout that fits is written where --layout gives none.",
)
@click.option(
    "--lever",
    "lever_mm",
    type=click.FloatRange(min=1e-3, max=1e5),
    metavar="MM",
    help="Radius at which what slides turns: mm and N over it become angle and torque.",
)
@click.option("--yes", is_flag=True, help="Take the guess as it is, doubts included.")
def command(
    files: tuple[Path, ...],
    out: Path,
    guessing: bool,
    layout: Path | None,
    dbc: Path | None,
    machine: str | None,
    lever_mm: float | None,
    yes: bool,
) -> None:
    """Import recordings: text with columns, spreadsheets, MATLAB, HDF5, NumPy, TDMS, MDF (MF4), Parquet,
    Feather, JSON, MCAP, ROS 1 and 2 bags, logs of a CAN bus (candump, ASC, BLF, TRC, CSV).

    A mapping (YAML) among FILE says what is what; further files then take the place of those it names.
    Without one, --guess proposes it: what it can see it takes, what it doubts it asks, and without a terminal
    it writes OUT.yaml and OUT.png and says which lines to confirm. The mapping that was used is kept in the
    dataset as import.yaml, with the files' hashes; with it the import can be repeated.

    A folder among FILE stands for the recordings in it, in the order of their names. What was confirmed of
    them is kept there as import.yaml, so that later files of the same kind need no question.

    \b
    needle-rig import campaign/ --layout shaft.yaml --out data/campaign
    needle-rig import log.csv --guess --layout shaft.yaml --out data/mine
    needle-rig import data/mine.yaml --out data/mine
    needle-rig import joint.csv --guess --machine joint --out data/joint
    needle-rig import slide.csv --guess --machine linear --lever 10 --out data/slide
    """
    from needle_rig.errors import BadInput
    from needle_rig.importing.asked import is_mapping
    from needle_rig.importing.campaign import MAPPING, is_campaign
    from needle_rig.questions.recordings import Understand

    if os.path.lexists(out):
        raise BadInput(f"{out}: exists already; name another folder with --out or remove it first")
    folder = next((file for file in files if is_campaign(file)), None)
    said = [file for file in files if is_mapping(file)]
    if folder is not None and not said and os.path.isfile(folder / MAPPING):
        said = [folder / MAPPING]
    named = next(iter(said), None)
    if named and guessing:
        raise BadInput(f"{named}: is a mapping already; leave --guess out, or remove it")
    guessing = guessing or (folder is not None and not named)
    if not named and not guessing:
        raise BadInput(f"{files[0]}: no mapping says what is what in it; --guess proposes one")
    found = Understand(
        files=files, name=out.resolve().name, layout=layout, dbc=dbc, machine=machine, lever_mm=lever_mm
    ).answer()
    for sentence in found.left:
        click.echo(sentence, err=True)
    if guessing:
        _tell(found.mapping)
    waiting = found.doubts()
    if not yes and waiting and not found.lacks() and guessing and sys.stdin.isatty():
        waiting = [doubt for doubt in waiting if not click.confirm(f"{doubt}. Is the line right?")]
    if found.lacks() or (waiting and not yes):
        raise BadInput(_to_confirm(found, out, waiting))
    for doubt in waiting:
        click.echo(f"taken as it is: {doubt}", err=True)
    found = found.confirmed()
    try:
        with found.written(out) as imported:
            drawn = _draw(found, out / PICTURE)
    except BadInput as error:
        if found.given:
            raise
        raise BadInput(
            f"{error}\nThe mapping is in {_keep(found, out)}; correct it there and import it"
        ) from None
    if folder is not None and not found.given:
        _keep_in(found, folder / MAPPING)
    dataset = imported.dataset
    samples = sum(len(trial.trial.time_s) for trial in dataset.trials)
    for note in imported.notes:
        click.echo(note, err=True)
    click.echo(
        f"{out}: {len(dataset.trials)} trials, {len(dataset.replicates)} commands, {samples} samples"
        + (f"; see {out / PICTURE}" if drawn else "")
    )


def _tell(mapping: Mapping) -> None:
    """Every line of a guess with its reason, and what became of all columns."""
    from needle_rig.importing.became import became

    for name, clock in mapping.clocks.items():
        source = clock.source or (f"{clock.rate_hz:g} Hz" if clock.rate_hz else "?")
        click.echo(f"clock {name}: {source} {clock.unit or ''} ({clock.why or 'not known'})")
    for channel in mapping.channels:
        sign = "−" if channel.sign < 0 else ""
        click.echo(f"{channel.role}: {sign}{channel.source}, {channel.unit or 'unit ?'} ({channel.why})")
    if mapping.layout.why:
        click.echo(f"layout: {mapping.layout.why}")
    for column in mapping.not_used:
        click.echo(f"not used: {column.source} ({column.why})")
    ends = Counter(column.how for column in became(mapping))
    click.echo("columns: " + ", ".join(f"{count} {how}" for how, count in ends.items()))


def _to_confirm(found: Understood, out: Path, waiting: list[str]) -> str:
    if found.given:
        next_step = "correct these lines, remove `doubt` from those that are right, and import again"
    else:
        place = _keep(found, out)
        next_step = f"confirm or correct these lines in {place} (remove `doubt`), then import it"
    return "\n".join([*found.lacks(), *waiting, next_step])


def _keep(found: Understood, out: Path) -> Path:
    """Write the mapping and its picture beside the dataset that is to be."""
    from needle_rig.importing import write_mapping

    place = out.with_name(out.name + ".yaml")
    place.parent.mkdir(parents=True, exist_ok=True)
    write_mapping(found.mapping, place, found.folder)
    _draw(found, out.with_name(out.name + ".png"))
    return place


def _keep_in(found: Understood, place: Path) -> None:
    """Write the mapping beside the recordings, for those that come later; say so where that fails."""
    from needle_rig.importing import write_mapping

    try:
        write_mapping(found.mapping, place, found.folder)
    except OSError as error:
        click.echo(f"{place}: cannot be written ({error.strerror}); give the dataset's import.yaml", err=True)


def _draw(found: Understood, path: Path) -> bool:
    """Draw what was understood; says so where that cannot be drawn here."""
    from needle_rig.errors import BadInput

    try:
        from needle_rig.figures.importing import Drawn, draw_import
    except BadInput as error:
        click.echo(f"no picture: {error}", err=True)
        return False
    from needle_rig.importing.preview import preview

    shown, loop = preview(found.mapping, found.folder, found.recordings)
    draw_import([Drawn(f"{s.role} ← {s.source}", s.unit, s.time_s, s.values) for s in shown], loop, path)
    return True
