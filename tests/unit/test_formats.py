"""Formats have numbers: of each kind of file a newer one is refused in a sentence, an older one migrated."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from needle_rig.calibration.kept import read_calibration
from needle_rig.config import file_kinds
from needle_rig.config.file_kinds import KINDS
from needle_rig.config.files import shipped_file
from needle_rig.config.loader import load_rig_config
from needle_rig.config.places import read_yaml, write_yaml
from needle_rig.dataset import read_dataset
from needle_rig.dataset.protocol import load_protocol
from needle_rig.dataset.settled import read_settled
from needle_rig.errors import BadInput
from needle_rig.importing.mapping import read_mapping
from needle_rig.model import load_model, load_parameters
from needle_rig.model.files import SavedModel, save_model
from needle_rig.recording import RunFile
from needle_rig.recording.tables import run_attributes, run_tables
from needle_rig.recording.writer import RunWriter
from needle_rig.records import JsonObject
from needle_rig.service.installed.installation import Installation
from needle_rig.service.setup.archive import packed
from needle_rig.service.setup.backup import back_up
from needle_rig.version import VERSION
from needle_rig.workbench.learning.diagnosis_file import _checksum, load_diagnosis
from needle_rig.workbench.learning.watched_runs import WatchedRun, _kept_run

OLD_KEY = "called_before"
"""What the fake format 0 of every kind calls the key that `KEYS` names."""
KEYS = {
    "needle-rig": "name",
    "needle-rig-dataset": "name",
    "needle-rig-settled": "name",
    "needle-rig-import": "clocks",
    "needle-rig-parameters": "name",
    "needle-rig-model": "name",
    "needle-rig-protocol": "trials",
    "needle-rig-diagnosis": "verdict",
    "needle-rig-watch": "run",
    "needle-rig-calibration": "node",
    "needle-rig-run": "strategy",
    "needle-rig-backup": "files",
    "needle-rig-report": "files",
}
"""A key of each kind that its reader cannot do without."""


def config(name: str) -> Path:
    return shipped_file("rig.yaml").parent / name


def a_model(folder: Path) -> Path:
    save_model(folder / "model.yaml", SavedModel(load_parameters("rig_rigid"), "rig_rigid"))
    return folder / "model.yaml"


def a_dataset(folder: Path) -> Path:
    shutil.copytree(config("new/dataset"), folder / "data")
    return folder / "data" / "dataset.yaml"


def a_diagnosis(folder: Path) -> Path:
    content: JsonObject = {
        "program": VERSION,
        "dataset": {"name": "d", "sha256": "0" * 64},
        "started_from": "null",
        "verdict": "none",
        "effects": [],
        "held_out_error": {"before": 1.0, "after": None},
        "noise": {"torque": 1.0},
        "policy": {},
        "explanations": [],
    }
    whole = {"format": "needle-rig-diagnosis/1", "checksum": _checksum(content), **content}
    return written(folder / "diagnosis.yaml", whole)


def a_watched_run(folder: Path) -> Path:
    path = folder / "run.json"
    path.write_text(json.dumps(WatchedRun(run="a", started_utc="2026-01-01").model_dump()))
    return path


def a_calibration(folder: Path) -> Path:
    return written(folder / "torque.yaml", {"format": "needle-rig-calibration/1", "node": "torque"})


def a_run(folder: Path) -> Path:
    attributes = run_attributes(load_rig_config(), strategy="none", target_deg=1.0, parameters="")
    with RunWriter(folder / "a.h5", attributes, run_tables(4)) as writer:
        writer.close({"status": "aligned"}, time_s=1.0)
    return folder / "a.h5"


def an_archive(folder: Path) -> Path:
    place = Installation(folder / "rig")
    place.rig_file.parent.mkdir(parents=True)
    shutil.copy(shipped_file("rig.hardware.yaml"), place.rig_file)
    back_up(place, folder / "rig.zip", with_runs=False)
    return folder / "rig.zip"


def a_report(folder: Path) -> Path:
    path = an_archive(folder)
    return archive_written(path, archive_read(path) | {"format": "needle-rig-report/1"})


def copied(name: str) -> Callable[[Path], Path]:
    return lambda folder: Path(shutil.copy(config(name), folder))


def opened(kind: str) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        with packed(path, kind) as archive:
            return archive.entries

    return read


def written(path: Path, data: JsonObject) -> Path:
    path.write_text(write_yaml(data), encoding="utf-8")
    return path


def archive_read(path: Path) -> JsonObject:
    with zipfile.ZipFile(path) as archive:
        content: JsonObject = json.loads(archive.read("contents.json"))
    return content


def archive_written(path: Path, data: JsonObject) -> Path:
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in (members | {"contents.json": json.dumps(data).encode()}).items():
            archive.writestr(name, content)
    return path


def run_read(path: Path) -> JsonObject:
    with h5py.File(path) as file:
        return dict(file.attrs)


def run_written(path: Path, data: JsonObject) -> Path:
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        for name in set(file.attrs) - set(data):
            del file.attrs[name]
        for name, value in data.items():
            file.attrs[name] = value
    return path


def json_written(path: Path, data: JsonObject) -> Path:
    path.write_text(json.dumps(data))
    return path


MADE: dict[str, Callable[[Path], Path]] = {
    "needle-rig": copied("rig.yaml"),
    "needle-rig-dataset": a_dataset,
    "needle-rig-settled": copied("datasets/reed2008/settled.yaml"),
    "needle-rig-import": copied("recordings/davinci.yaml"),
    "needle-rig-parameters": copied("parameters/rig_rigid.yaml"),
    "needle-rig-model": a_model,
    "needle-rig-protocol": copied("protocols/standard.yaml"),
    "needle-rig-diagnosis": a_diagnosis,
    "needle-rig-watch": a_watched_run,
    "needle-rig-calibration": a_calibration,
    "needle-rig-run": a_run,
    "needle-rig-backup": an_archive,
    "needle-rig-report": a_report,
}
READERS: dict[str, Callable[[Path], object]] = {
    "needle-rig": load_rig_config,
    "needle-rig-dataset": lambda file: read_dataset(file.parent),
    "needle-rig-settled": lambda file: read_settled(file.parent),
    "needle-rig-import": lambda file: read_mapping(file)[0],
    "needle-rig-parameters": load_parameters,
    "needle-rig-model": load_model,
    "needle-rig-protocol": load_protocol,
    "needle-rig-diagnosis": load_diagnosis,
    "needle-rig-watch": _kept_run,
    "needle-rig-calibration": lambda file: read_calibration(file)["node"],
    "needle-rig-run": lambda file: RunFile(file).attributes["strategy"],
    "needle-rig-backup": opened("backup"),
    "needle-rig-report": opened("report"),
}


def read(path: Path) -> JsonObject:
    if path.suffix == ".zip":
        return archive_read(path)
    if path.suffix == ".h5":
        return run_read(path)
    return json.loads(path.read_bytes()) if path.suffix == ".json" else read_yaml(path)[0]


def write(path: Path, data: JsonObject) -> Path:
    way = {".zip": archive_written, ".h5": run_written, ".json": json_written}.get(path.suffix, written)
    return way(path, data)


def of_format_zero(kind: str, path: Path) -> Path:
    """The file as a needle-rig before this one would have written it."""
    content = read(path)
    old = {OLD_KEY if key == KEYS[kind] else key: value for key, value in content.items()}
    old["format"] = f"{kind}/0"
    if "checksum" in old:
        old["checksum"] = _checksum({key: value for key, value in old.items() if key != "checksum"})
    return write(path, old)


def fake_migration(kind: str) -> Callable[[JsonObject], JsonObject]:
    def migrate(data: JsonObject) -> JsonObject:
        data[KEYS[kind]] = data.pop(OLD_KEY)
        return data

    return migrate


def test_every_kind_of_file_is_tried_here() -> None:
    assert set(KINDS) == set(KEYS) == set(MADE) == set(READERS)


@pytest.mark.parametrize("kind", KINDS)
def test_an_older_format_is_migrated_and_without_a_migration_refused(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = MADE[kind](tmp_path)
    write(path, read(path))
    today = READERS[kind](path)
    of_format_zero(kind, path)
    with pytest.raises(BadInput, match=r"version '0' of .* is not known, this needle-rig reads") as refused:
        READERS[kind](path)
    assert "\n" not in str(refused.value)
    monkeypatch.setitem(file_kinds.MIGRATIONS, f"{kind}/0", fake_migration(kind))
    migrated = READERS[kind](path)
    assert type(migrated) is type(today)
    assert repr(migrated) == repr(today)
    assert OLD_KEY in read(path), "the file stays as it was"


@pytest.mark.parametrize("kind", KINDS)
def test_a_newer_format_is_refused_in_one_sentence_with_what_to_do(kind: str, tmp_path: Path) -> None:
    path = MADE[kind](tmp_path)
    content = read(path)
    del content[KEYS[kind]]
    write(path, content | {"format": f"{kind}/2", "unheard_of": 1})
    with pytest.raises(BadInput) as refused:
        READERS[kind](path)
    sentence = str(refused.value)
    assert path.name in sentence
    assert f"format 2; needle-rig {VERSION} reads up to 1: upgrade needle-rig" in sentence
    assert "\n" not in sentence
    known_writer = kind.removeprefix("needle-rig-") in ("model", "diagnosis", "run", "backup", "report")
    assert (f"written by needle-rig {VERSION}" in sentence) == known_writer


def test_migrations_follow_one_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two steps, the first from before numbers began; the options of a command name the keys of today."""
    path = MADE["needle-rig"](tmp_path)
    content = read(path)
    content["older"] = content.pop("name")
    write(path, content | {"format": "needle-rig/0"})
    monkeypatch.setitem(file_kinds.MIGRATIONS, "needle-rig/0", lambda d: {OLD_KEY: d.pop("older")} | d)
    with pytest.raises(BadInput, match=OLD_KEY):
        load_rig_config(path, {"name": "mine"})
    monkeypatch.setitem(file_kinds.MIGRATIONS, "needle-rig/0", lambda d: {"name": d.pop("older")} | d)
    assert load_rig_config(path).name == content["older"]
    assert load_rig_config(path, {"name": "mine"}).name == "mine"


@pytest.mark.parametrize("number", ["99999999999999999999", "-1", "1.5", "٢", "", "1/1", "9" * 5000])
def test_a_number_that_is_none_is_told_in_a_short_sentence(number: str, tmp_path: Path) -> None:
    for kind in ("needle-rig-run", "needle-rig-model"):
        (tmp_path / kind).mkdir()
        path = MADE[kind](tmp_path / kind)
        write(path, read(path) | {"format": f"{kind}/{number}"})
        with pytest.raises(BadInput) as refused:
            READERS[kind](path)
        assert len(str(refused.value)) < len(str(path)) + 400


def test_a_run_of_a_newer_format_may_have_other_tables(tmp_path: Path) -> None:
    path = a_run(tmp_path)
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        del file["events"]
        file.create_dataset("happenings", data=[1, 2])
        file.attrs["format"] = "needle-rig-run/2"
        file.attrs["versions"] = '{"needle-rig": "0.9.3"}'
    with pytest.raises(BadInput, match=r"a run written by needle-rig 0\.9\.3, format 2"):
        RunFile(path)
