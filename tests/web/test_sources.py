"""What the page may read, and what people add to a run."""

import json
from pathlib import Path

import pytest

from needle_rig.errors import BadInput
from needle_rig.notebook import simulate
from needle_rig.web.sources import NOTES_SUFFIX, Sources
from needle_rig.web.uploads import Uploads


@pytest.fixture
def sources(tmp_path: Path) -> Sources:
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "one.h5").write_bytes(b"no run")
    simulate({}, out=tmp_path / "data" / "mine")
    return Sources([tmp_path / "data"], tmp_path / "runs", Uploads(tmp_path / "uploads"))


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
