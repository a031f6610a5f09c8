"""What the page may read, and what people add to a run."""

import json
import time
from pathlib import Path
from typing import Any

import pytest

from needle_rig.errors import BadInput
from needle_rig.notebook import simulate
from needle_rig.recording import changed_in
from needle_rig.web import run_index
from needle_rig.web.run_index import READ_AS, RunIndex
from needle_rig.web.sources import NOTES_SUFFIX, RUNS_SHOWN, Listed, Sources
from needle_rig.web.store import Store
from needle_rig.web.uploads import Uploads

MANY = 20_000


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


def recorded(runs: Path, store: Store) -> None:
    """Many runs, known to `store` as a server left them that ended."""
    runs.mkdir(exist_ok=True)
    known = {
        "simulated": True,
        "started_utc": "2026-01-01T00:00:00Z",
        "target_deg": 45.0,
        "strategy": "reed2008",
        "parameters": "rig_elastic",
        "status": "aligned",
        "duration_s": 20.0,
        "tip_lag_deg": 1.0,
    }
    names = [f"run_{k:05d}" for k in range(MANY)]
    for name in names:
        (runs / f"{name}.h5").write_bytes(b"no run")
    stamps = changed_in(runs)
    # the files themselves are read once, in the background
    store.keep_runs(
        {
            name: (f"{READ_AS}:{ns:020d}:{size}", {"name": name, **known})
            for name, (ns, size) in stamps.items()
        },
        [],
    )


@pytest.mark.whole
def test_twenty_thousand_runs_are_listed_within_a_second(tmp_path: Path) -> None:
    store = Store(tmp_path)
    recorded(tmp_path / "runs", store)
    many = Sources([], tmp_path / "runs", Uploads(tmp_path / "uploads"), RunIndex(store))
    begun_s = time.process_time()
    found = many.run_documents(Listed(filter="aligned", by="name", start=MANY - 50))
    assert time.process_time() - begun_s < 1.0
    assert (len(found["runs"]), found["of"], found["indexing"]) == (50, MANY, 0)
    assert found["runs"][-1]["name"] == "run_00000"
    store.close()


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
