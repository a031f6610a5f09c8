"""needle-rig import: recordings of any laboratory, as a dataset."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from needle_rig.importing import Mapping, Recordings

PICTURE = "import.png"


@click.command("import")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE…")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Dataset to write; must be new.")
@click.option("--guess", "guessing", is_flag=True, help="Propose the mapping from the files themselves.")
@click.option(
    "--layout",
    type=click.Path(path_type=Path),
    help="What the shaft looks like: a YAML file with the keys of `rig`, a rig file, or a dataset.",
)
@click.option("--yes", is_flag=True, help="Take the guess as it is, doubts included.")
def command(files: tuple[Path, ...], out: Path, guessing: bool, layout: Path | None, yes: bool) -> None:
    """Import recordings: text with columns, spreadsheets, MATLAB, HDF5, MCAP, ROS 2 bags, NumPy.

    A mapping (YAML) among FILE says what is what; further files then take the place of those it names.
    Without one, --guess proposes it: what it can see it takes, what it doubts it asks, and without a terminal
    it writes OUT.yaml and OUT.png and says which lines to confirm. The mapping that was used is kept in the
    dataset as import.yaml, with the files' hashes; with it the import can be repeated.

    \b
    needle-rig import log.csv --guess --layout shaft.yaml --out data/mine
    needle-rig import data/mine.yaml --out data/mine
    """
    from needle_rig.errors import BadInput
    from needle_rig.importing import Recordings, dataset_of
    from needle_rig.importing.asked import given_mapping, guessed_mapping, is_mapping
    from needle_rig.importing.keep import kept

    if os.path.lexists(out):
        raise BadInput(f"{out}: exists already; name another folder with --out or remove it first")
    named = [file for file in files if is_mapping(file)]
    others = [file for file in files if file not in named]
    if len(named) > 1:
        raise BadInput(f"{named[1]}: a second mapping; give one")
    if named and guessing:
        raise BadInput(f"{named[0]}: is a mapping already; leave --guess out")
    if not named and not guessing:
        raise BadInput(f"{files[0]}: no mapping says what is what in it; --guess proposes one")
    recordings = Recordings()
    if named:
        mapping, folder = given_mapping(named[0], others, layout)
    else:
        mapping, folder = guessed_mapping(others, out.resolve().name, layout, recordings), Path()
        _tell(mapping)
    waiting = mapping.doubts()
    if not yes and waiting and not mapping.lacks() and guessing and sys.stdin.isatty():
        waiting = [doubt for doubt in waiting if not click.confirm(f"{doubt}. Is the line right?")]
    if mapping.lacks() or (waiting and not yes):
        raise BadInput(_to_confirm(mapping, folder, recordings, None if named else out, waiting))
    for doubt in waiting:
        click.echo(f"taken as it is: {doubt}", err=True)
    mapping = mapping.confirmed()
    try:
        dataset = dataset_of(mapping, folder, recordings=recordings)
        with kept(dataset, mapping, folder, out) as left_out:
            drawn = _draw(mapping, folder, recordings, out / PICTURE)
    except BadInput as error:
        if named:
            raise
        place = _keep(mapping, folder, recordings, out)
        raise BadInput(f"{error}\nThe mapping is in {place}; correct it there and import it") from None
    samples = sum(len(trial.trial.time_s) for trial in dataset.trials)
    for note in (*dataset.notes, *left_out):
        click.echo(note, err=True)
    click.echo(
        f"{out}: {len(dataset.trials)} trials, {len(dataset.replicates)} commands, {samples} samples"
        + (f"; see {out / PICTURE}" if drawn else "")
    )


def _tell(mapping: Mapping) -> None:
    """Every line of a guess with its reason."""
    for name, clock in mapping.clocks.items():
        source = clock.source or (f"{clock.rate_hz:g} Hz" if clock.rate_hz else "?")
        click.echo(f"clock {name}: {source} {clock.unit or ''} ({clock.why or 'not known'})")
    for channel in mapping.channels:
        sign = "−" if channel.sign < 0 else ""
        click.echo(f"{channel.role}: {sign}{channel.source}, {channel.unit or 'unit ?'} ({channel.why})")
    if mapping.not_used:
        click.echo(f"not used: {', '.join(mapping.not_used)}")


def _to_confirm(
    mapping: Mapping, folder: Path, recordings: Recordings, out: Path | None, waiting: list[str]
) -> str:
    lines = [*mapping.lacks(), *waiting]
    if out is None:
        next_step = "correct these lines, remove `doubt` from those that are right, and import again"
    else:
        place = _keep(mapping, folder, recordings, out)
        next_step = f"confirm or correct these lines in {place} (remove `doubt`), then import it"
    return "\n".join([*lines, next_step])


def _keep(mapping: Mapping, folder: Path, recordings: Recordings, out: Path) -> Path:
    """Write the mapping and its picture beside the dataset that is to be."""
    from needle_rig.importing import write_mapping

    place = out.with_name(out.name + ".yaml")
    place.parent.mkdir(parents=True, exist_ok=True)
    write_mapping(mapping, place, folder)
    _draw(mapping, folder, recordings, out.with_name(out.name + ".png"))
    return place


def _draw(mapping: Mapping, folder: Path, recordings: Recordings, path: Path) -> bool:
    """Draw what was understood; says so where that cannot be drawn here."""
    from needle_rig.errors import BadInput

    try:
        from needle_rig.figures.importing import Drawn, draw_import
    except BadInput as error:
        click.echo(f"no picture: {error}", err=True)
        return False
    from needle_rig.importing.preview import preview

    shown, loop = preview(mapping, folder, recordings)
    draw_import([Drawn(f"{s.role} ← {s.source}", s.unit, s.time_s, s.values) for s in shown], loop, path)
    return True
