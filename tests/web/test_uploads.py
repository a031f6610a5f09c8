"""What a person drops: bounded in size, count and time, data alone, and never outside its folder."""

import asyncio
import errno
import io
import shutil
import stat
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from needle_rig.errors import BadInput
from needle_rig.web import uploads
from needle_rig.web.uploads import UPLOADS, NoRoom, TooMuch, Uploads, data_in


async def chunks(content: bytes, size: int = 1 << 16) -> AsyncIterator[bytes]:
    for begin in range(0, len(content), size):
        yield content[begin : begin + size]


def take(kept: Uploads, key: str, path: str, content: bytes = b"x") -> None:
    asyncio.run(kept.take(key, path, chunks(content)))


def zipped(**files: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return packed.getvalue()


@pytest.fixture
def kept(tmp_path: Path) -> Uploads:
    return Uploads(tmp_path / "uploads")


def files_of(tmp_path: Path) -> set[str]:
    return {path.name for path in tmp_path.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    "path",
    [
        "../a.csv",
        "/etc/a.csv",
        "a/../../b.csv",
        "a\\b.csv",
        "a/b/c/d/e/f/g.csv",
        ".a.csv",
        "x/.git/a.csv",
        "a\0.csv",
        "",
    ],
)
def test_a_path_that_leaves_the_folder_is_refused(kept: Uploads, tmp_path: Path, path: str) -> None:
    key = kept.begin("mine")
    with pytest.raises(BadInput):
        take(kept, key, path)
    assert not files_of(tmp_path)


@pytest.mark.parametrize("path", ["effect.py", "a.so", "a.pickle", "a.exe", "Makefile", "a.csv.py"])
def test_what_is_no_data_is_refused_so_that_no_effect_is_ever_uploaded(
    kept: Uploads, tmp_path: Path, path: str
) -> None:
    key = kept.begin("mine")
    with pytest.raises(BadInput, match="not taken"):
        take(kept, key, path)
    with pytest.raises(BadInput, match="not taken"):
        take(kept, key, "all.zip", zipped(**{path: b"x"}))
    assert not files_of(tmp_path)


def test_a_zip_bomb_is_stopped_at_the_limit_and_leaves_nothing(
    kept: Uploads, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, "UPLOAD_BYTES", 1 << 20)
    bomb = zipped(**{f"{k}.csv": b"0" * (300 << 10) for k in range(8)})
    assert len(bomb) < 10_000
    with pytest.raises(TooMuch, match="larger than 1 MiB"):
        take(kept, kept.begin("mine"), "bomb.zip", bomb)
    assert not files_of(tmp_path)


@pytest.mark.parametrize("name", ["../out.csv", "/out.csv", "a/../../out.csv"])
def test_a_zip_cannot_write_outside_its_folder(kept: Uploads, tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInput):
        take(kept, kept.begin("mine"), "slip.zip", zipped(**{name: b"x"}))
    assert not files_of(tmp_path)


def test_links_in_a_zip_are_refused(kept: Uploads, tmp_path: Path) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        entry = zipfile.ZipInfo("a.csv")
        entry.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(entry, "/etc/passwd")
    with pytest.raises(BadInput, match="link"):
        take(kept, kept.begin("mine"), "link.zip", packed.getvalue())
    assert not files_of(tmp_path)


@pytest.mark.parametrize(
    "content", [b"", b"no zip", zipped(**{"a.csv": b"x" * 5000})[:-30]], ids=["empty", "no zip", "cut off"]
)
def test_a_broken_zip_is_refused_in_a_sentence(kept: Uploads, tmp_path: Path, content: bytes) -> None:
    with pytest.raises(BadInput, match="cannot be unpacked"):
        take(kept, kept.begin("mine"), "broken.zip", content)
    assert not files_of(tmp_path)


def test_too_many_files_too_large_ones_and_slow_ones_are_refused(
    kept: Uploads, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, "FILES", 2)
    key = kept.begin("mine")
    take(kept, key, "a.csv")
    take(kept, key, "b.csv")
    with pytest.raises(TooMuch, match="more than 2 files"):
        take(kept, key, "c.csv")
    with pytest.raises(TooMuch, match="holds 3 files"):
        take(kept, kept.begin("other"), "d.zip", zipped(**{f"{k}.csv": b"" for k in range(3)}))
    monkeypatch.setattr(uploads, "FILE_BYTES", 10)
    with pytest.raises(TooMuch, match="is larger than"):
        take(kept, kept.begin("large"), "e.csv", b"x" * 11)

    async def never() -> AsyncIterator[bytes]:
        yield b"x"
        await asyncio.sleep(60)

    monkeypatch.setattr(uploads, "UPLOAD_S", 0.05)
    with pytest.raises(TooMuch, match="did not come"):
        asyncio.run(kept.take(kept.begin("slow"), "f.csv", never()))
    assert files_of(tmp_path) == {"a.csv", "b.csv"}


def test_datasets_are_found_in_what_was_dropped_and_runs_where_there_is_none(
    tmp_path: Path, run_path: Path
) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "other.h5").write_bytes(b"HDF5 of another program")
    assert data_in(tmp_path) == []
    shutil.copy(run_path, tmp_path / "run.h5")
    assert data_in(tmp_path) == [tmp_path / "run.h5"]
    (tmp_path / "one" / "dataset.yaml").write_text("")
    assert data_in(tmp_path) == [tmp_path / "one"]


def test_the_oldest_drop_goes_and_one_that_holds_nothing_before_it(tmp_path: Path) -> None:
    async def one() -> AsyncIterator[bytes]:
        yield b"x"

    gone: list[str] = []
    kept = Uploads(tmp_path, gone.append)
    keys = [kept.begin(f"{k}") for k in range(UPLOADS)]
    for k, key in enumerate(keys):
        if k != 7:
            asyncio.run(kept.take(key, "a.csv", one()))
    kept.begin("new")
    kept.begin("newer")
    assert gone[0] == keys[7]
    assert len(kept.all()) == UPLOADS
    assert not (tmp_path / keys[7]).exists()


def test_a_full_disk_is_told_as_what_it_is(tmp_path: Path) -> None:
    async def full() -> AsyncIterator[bytes]:
        yield b"x"
        raise OSError(errno.ENOSPC, "No space left on device")

    kept = Uploads(tmp_path)
    with pytest.raises(NoRoom, match=r"a\.csv: cannot be written \(No space left on device\); make room"):
        asyncio.run(kept.take(kept.begin("mine"), "a.csv", full()))
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
