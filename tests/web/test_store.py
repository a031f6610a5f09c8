"""What is kept beside the runs: whose work it is, and what of it may run as code."""

from __future__ import annotations

from pathlib import Path

import pytest

from needle_rig.web import places
from needle_rig.web.identity import data_hash, model_hash
from needle_rig.web.jobs import CLOSED, Jobs
from needle_rig.web.store import DATABASE, FOLDER, Store, opened, seal, sealed

OF: dict[str, object] = {
    "kind": "diagnose",
    "data": [["shipped:a", "a"]],
    "model": None,
    "question": "q",
    "asked": {},
    "drafts": [],
}
RUNNING = {"state": "running", "begun_utc_s": 1.0, "ended_utc_s": None, "name": "", "added": [], "error": ""}


def test_work_that_ran_when_its_server_ended_is_told_so(tmp_path: Path) -> None:
    with opened(tmp_path, tmp_path / "otherwise") as (store, why):
        assert why == ""
        store.keep_job("k", ("data", "model"), 1.0, {**RUNNING, "of": OF}, None)
    with opened(tmp_path, tmp_path / "otherwise") as (store, _):
        (job,) = Jobs(store, tmp_path / "scratch").all()
    assert (job.state, job.error, job.of.hashes, job.of.data) == (
        "failed",
        CLOSED,
        ("data", "model"),
        (("shipped:a", "a"),),
    )


def test_a_store_serves_one_server_at_a_time(tmp_path: Path) -> None:
    with opened(tmp_path, tmp_path / "a") as (first, _), opened(tmp_path, tmp_path / "b") as (second, why):
        assert first.folder == tmp_path / FOLDER
        assert second.folder == tmp_path / "b"
        assert "another needle-rig web keeps its work" in why


@pytest.mark.parametrize("content", [b"", b"no database at all, but text that is long enough" * 9])
def test_a_damaged_store_is_a_sentence_and_the_page_goes_on(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FOLDER / DATABASE).write_bytes(content)
    with opened(tmp_path, tmp_path / "otherwise") as (store, why):
        assert (why == "") == (content == b"")
        store.keep_upload("k", {"name": "mine"})
        assert list(store.uploads()) == ["k"]


def test_where_nothing_can_be_written_the_page_goes_on(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("a file")
    with opened(tmp_path / "runs", tmp_path / "otherwise") as (store, why):
        assert "cannot be used" in why
        assert store.jobs is not None


def test_python_runs_only_with_the_seal_of_this_users_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "mine"))
    law = tmp_path / "law"
    law.mkdir()
    (law / "learnt_law_1.py").write_text("x = 1\n")
    assert not sealed(law)
    seal(law)
    assert sealed(law)
    (law / "learnt_law_1.py").write_text("x = 2\n")
    assert not sealed(law)
    (law / "learnt_law_1.py").write_text("x = 1\n")
    (law / "more.py").write_text("")
    assert not sealed(law)
    (law / "more.py").unlink()
    assert sealed(law)
    # the same folder at another person, who brings no key along
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "anothers"))
    assert not sealed(law)


def test_no_pickle_lies_where_work_is_kept(tmp_path: Path) -> None:
    store = Store(tmp_path)
    jobs = Jobs(store, tmp_path / "scratch")
    folder = jobs._folder("compare", "k")
    assert folder.is_relative_to(tmp_path / "scratch")
    source = Path(places.__file__).parent
    writers = [
        path.stem for path in source.glob("*.py") if "pickle.dumps" in path.read_text(encoding="utf-8")
    ]
    assert writers == ["pictures"]
    store.close()


def test_a_hash_is_of_content_and_not_of_places(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "dataset.yaml").write_text("name: x")
    assert data_hash([str(tmp_path / "a")]) == data_hash([str(tmp_path / "b")])
    before = data_hash([str(tmp_path / "a")])
    (tmp_path / "a" / "dataset.yaml").write_text("name: yy")
    assert data_hash([str(tmp_path / "a")]) != before
    effects = tmp_path / "effects"
    effects.mkdir()
    without = model_hash(None, [str(effects)])
    (effects / "mine.py").write_text("x = 1")
    assert model_hash(None, [str(effects)]) != without
    assert model_hash("rig_soft", []) != model_hash(None, [])
