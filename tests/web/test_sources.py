"""What the page may read, and what people add to a run."""

import json
import time
from pathlib import Path
from typing import Any

import pytest

from needle_rig.errors import BadInput
from needle_rig.notebook import simulate
from needle_rig.web import run_index
from needle_rig.web.run_index import RunIndex
from needle_rig.web.sources import NOTES_SUFFIX, RUNS_SHOWN, Listed, Sources
from needle_rig.web.store import Store
from needle_rig.web.uploads import Uploads


@pytest.fixture
def sources(tmp_path: Path) -> Sources:
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "one.h5").write_bytes(b"no run")
    simulate({}, out=tmp_path / "data" / "mine")
    return Sources(
        [tmp_path / "data"], tmp_path / "runs", Uploads(tmp_path / "uploads"), RunIndex(Store(tmp_path))
    )


def test_a_key_stands_for_what_was_named_and_for_nothing_else(sources: Sources, tmp_path: Path) -> None:
    listed = {source.name: source.key for source in sources.datasets()}
    assert set(listed) == {"data/mine", "reed2008"}
    assert sources.paths([listed["data/mine"]]) == [str(tmp_path / "data" / "mine")]
    for key in ("data:0:../runs", "data:1:mine", "/etc", "run:../one", "upload:x", "shipped:../x", ""):
        with pytest.raises(BadInput):
            sources.paths([key])


def test_notes_stand_beside_the_run_which_is_not_changed(sources: Sources, tmp_path: Path) -> None:
    sources.keep_notes("one", b'{"tags": ["good"], "note": "<b>\\u00fc</b>"}')
    assert sources.notes("one").tags == ["good"]
    assert (tmp_path / "runs" / "one.h5").read_bytes() == b"no run"
    kept = json.loads((tmp_path / "runs" / f"one{NOTES_SUFFIX}").read_text(encoding="utf-8"))
    assert kept == {"tags": ["good"], "note": "<b>ü</b>"}


@pytest.mark.parametrize(
    "content", [b"", b"[]", b'{"tags": "x"}', b'{"tags": [""]}', b'{"note": 1}', b'{"more": 1}']
)
def test_notes_of_another_form_are_refused(sources: Sources, tmp_path: Path, content: bytes) -> None:
    with pytest.raises(BadInput):
        sources.keep_notes("one", content)
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["one.h5"]


@pytest.mark.parametrize("name", ["two", "../one", "/etc/passwd", ""])
def test_there_are_no_notes_on_what_is_no_listed_run(sources: Sources, name: str) -> None:
    with pytest.raises(BadInput):
        sources.keep_notes(name, b"{}")


def test_damaged_notes_count_as_none(sources: Sources, tmp_path: Path) -> None:
    (tmp_path / "runs" / f"one{NOTES_SUFFIX}").write_text("{", encoding="utf-8")
    assert sources.notes("one").note == ""


def test_two_tabs_keep_each_others_tags_and_note(sources: Sources) -> None:
    sources.keep_notes("one", b'{"note": "by one tab"}')
    sources.keep_notes("one", b'{"tags": ["by another"]}')
    assert sources.notes("one").model_dump() == {"tags": ["by another"], "note": "by one tab"}


def test_a_run_is_read_once_until_its_file_changes(
    sources: Sources, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    summary = run_index.read_document

    def counted(path: Path) -> dict[str, Any]:
        read.append(path.name)
        return summary(path)

    monkeypatch.setattr(run_index, "read_document", counted)
    for _ in range(2):
        assert [run["name"] for run in sources.run_documents(Listed())["runs"]] == ["one"]
    assert read == ["one.h5"]
    (tmp_path / "runs" / "one.h5").write_bytes(b"no run either")
    assert sources.run_documents(Listed(filter="unreadable"))["of"] == 1
    assert read == ["one.h5", "one.h5"]
    (tmp_path / "runs" / "one.h5").unlink()
    assert sources.run_documents(Listed())["runs"] == []


def test_runs_are_shown_in_pages_and_in_the_order_that_is_asked(sources: Sources, tmp_path: Path) -> None:
    for k in range(RUNS_SHOWN + 5):
        (tmp_path / "runs" / f"run_{k:03d}.h5").write_bytes(b"no run")
    deadline_s = time.monotonic() + 20.0
    while sources.run_documents(Listed())["indexing"] and time.monotonic() < deadline_s:
        time.sleep(0.02)
    first = sources.run_documents(Listed(by="name", down=False))
    assert [run["name"] for run in first["runs"]] == ["one", *(f"run_{k:03d}" for k in range(RUNS_SHOWN - 1))]
    assert first["of"] == RUNS_SHOWN + 6
    last = sources.run_documents(Listed(by="name", down=False, start=RUNS_SHOWN))
    assert [run["name"] for run in last["runs"]] == [
        f"run_{k:03d}" for k in range(RUNS_SHOWN - 1, RUNS_SHOWN + 5)
    ]
