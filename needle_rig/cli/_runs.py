"""What commands that name runs share: where runs lie, and which one is meant."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from needle_rig.recording import RunFile

directory_option = click.option(
    "--dir",
    "directory",
    type=click.Path(path_type=Path),
    help="Folder of the runs.  [default: recording.directory of the rig file, or the service's]",
)
config_option = click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path),
    help="Rig file.  [default: the nearest rig.yaml]",
)


def runs_directory(directory: Path | None, config_path: Path | None) -> Path:
    """The folder of runs that a person means."""
    if directory is not None:
        return directory
    from needle_rig.config.loader import load_rig_config
    from needle_rig.service.installed.installation import HERE

    nearest = Path("config/rig.yaml")
    if config_path is None and not nearest.is_file() and (of_service := HERE.runs_directory()) is not None:
        return of_service
    if config_path is not None and config_path.resolve() == HERE.rig_file:
        return HERE.runs_directory() or HERE.runs
    return Path(load_rig_config(config_path).recording.directory)


def the_run(named: str, directory: Path | None, config_path: Path | None) -> RunFile:
    """The run called `named` (a path, a listed name, a part of it, or `last`); raises BadInput."""
    from needle_rig.recording import RunFile, find_run, is_run_file

    if is_run_file(named):
        return RunFile(named)
    return find_run(named, runs_directory(directory, config_path))


def learned_extra_deg(run: RunFile) -> float:
    """The extra turn that `run` teaches reed2008_elastic: what it used and the lag that it left, in degrees.

    Raises BadInput when `run` is not a sequence of reed2008's kind that ran to its end.
    """
    from needle_rig.errors import BadInput

    result: Any = run.result or {}
    try:
        motions = {motion["phase"]: motion for motion in result.get("motions", [])}
        if result.get("status") not in ("aligned", "not_aligned") or not {"overshoot", "final"} <= set(
            motions
        ):
            raise BadInput(
                f"--after {run.name}: is no run of reed2008 or reed2008_elastic that came to its end"
            )
        target_deg, lag_deg = result["target_deg"], result["lag_deg"]
        side = -1.0 if target_deg < 0 else 1.0
        used_deg = side * (motions["overshoot"]["base_deg"] - target_deg - lag_deg)
        extra_deg = float(used_deg + side * (target_deg - motions["final"]["hall_deg"][-1]))
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        raise BadInput(
            f"--after {run.name}: its result is damaged ({type(error).__name__}: {error}); name another run"
        ) from None
    if not math.isfinite(extra_deg):
        raise BadInput(f"--after {run.name}: its result holds no finite angle; name another run")
    return extra_deg
