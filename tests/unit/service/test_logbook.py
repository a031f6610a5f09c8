"""The next daemon tells how the one before ended."""

from __future__ import annotations

from pathlib import Path

import pytest

from needle_rig.service.installed.logbook import Logbook
from needle_rig.service.tick.repeats import QUIET_S, Repeats


def begun(folder: Path, boot_id: str = "boot 1") -> Logbook:
    book = Logbook(folder, boot_id)
    book.begin()
    return book


def test_the_first_daemon_has_none_before_it(tmp_path: Path) -> None:
    book = begun(tmp_path / "runs")
    assert book.before == ""
    assert book.since_utc.endswith("+00:00")


def test_an_end_in_order_is_told_with_its_reason_and_time(tmp_path: Path) -> None:
    begun(tmp_path).end("it was told to end")
    # the unit writes this after every end
    (tmp_path / ".ending").write_text("success exited 0\n")
    before = begun(tmp_path, "boot 2").before
    assert before.endswith(": it was told to end")
    assert before.startswith("20")


@pytest.mark.parametrize(
    ("ending", "words"),
    [
        ("watchdog dumped ABRT", "its watchdog"),
        ("signal killed KILL", "was killed (signal KILL)"),
        ("core-dump dumped SEGV", "was killed (signal SEGV)"),
        ("exit-code exited 70", "failed (exit 70)"),
        ("timeout killed TERM", "did not start or end in time"),
        ("", "without a word"),
        ("\x00\xff", "without a word"),
    ],
    ids=str,
)
def test_what_systemd_saw_of_an_end_without_a_word_is_told(tmp_path: Path, ending: str, words: str) -> None:
    since = begun(tmp_path).since_utc
    (tmp_path / ".ending").write_text(ending)
    after = begun(tmp_path)
    assert words in after.before
    assert since in after.before
    assert "journalctl -u needle-rig" in after.before
    # what was told once does not stand for the next end
    assert "without a word" in begun(tmp_path).before


def test_another_boot_is_a_power_cut(tmp_path: Path) -> None:
    begun(tmp_path, "boot 1")
    assert "power cut" in begun(tmp_path, "boot 2").before


@pytest.mark.parametrize("text", ["", "[]", "{", "\x00" * 10_000], ids=["empty", "a list", "half", "zeros"])
def test_a_damaged_book_is_as_good_as_none(tmp_path: Path, text: str) -> None:
    (tmp_path / ".daemon.json").write_text(text)
    assert begun(tmp_path).before == ""


def test_nothing_is_kept_without_a_folder_or_where_none_can_be_written(tmp_path: Path) -> None:
    Logbook(None).begin()
    by_hand = Logbook.of_service({})
    by_hand.begin()
    assert by_hand.before == ""
    assert by_hand.since_utc
    of_service = Logbook.of_service({"STATE_DIRECTORY": f"{tmp_path}/state:/elsewhere"})
    of_service.begin()
    assert (tmp_path / "state/.daemon.json").is_file()
    (tmp_path / "file").write_text("")
    book = begun(tmp_path / "file" / "below")
    book.end("it was told to end")
    assert book.before == ""


def test_what_comes_and_goes_is_told_once_a_minute_with_its_count() -> None:
    repeats = Repeats()
    told = {t: times for t in range(190) if (times := repeats.count("hall", t)) is not None}
    assert told == {0: 1, 60: 60, 120: 60, 180: 60}
    assert repeats.count("torque", 5) == 1
    assert repeats.count("torque", 5 + QUIET_S - 0.1) is None
