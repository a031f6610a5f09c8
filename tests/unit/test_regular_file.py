"""What is no regular file is refused in a sentence, without waiting and without a byte of it read."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import Any

import pytest

from needle_rig.config import places
from needle_rig.config.places import parse_yaml, read_yaml
from needle_rig.config.regular_file import open_regular, read_regular
from needle_rig.errors import BadInput


def test_a_regular_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("a")
    assert read_regular(tmp_path / "a", "a", 5) == b"12345"
    assert read_regular(tmp_path / "link", "link", 5, inside=tmp_path) == b"12345"


def test_a_folder_that_is_itself_a_link_holds_its_files(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data/a").write_bytes(b"1")
    (tmp_path / "here").symlink_to("data")
    assert read_regular(tmp_path / "here/a", "a", 5, inside=tmp_path / "here") == b"1"


@pytest.mark.parametrize(
    "name", ["pipe", "folder", "socket", "device", "loop", "gone", "n\0ul", "l" * 5000, "a/b"]
)
def test_what_is_no_file_is_named(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a").write_bytes(b"")
    os.mkfifo("pipe")
    Path("folder").mkdir()
    Path("device").symlink_to("/dev/zero")
    Path("loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("socket")
    says = {
        "pipe": "pipe: is a pipe, not a file that can be read",
        "folder": "folder: is a folder",
        "socket": "socket: is a socket",
        "device": "device: is a device",
        "loop": "loop: is a link that leads back to itself",
        "gone": "gone: there is no such file, look elsewhere",
        "a/b": "a/b: there is no such file, look elsewhere",
        "n\0ul": "no file's name has a null character",
        "l" * 5000: r"l…: cannot be read: File name too long \(5000 letters\)",
    }[name]
    opened: list[object] = []
    monkeypatch.setattr(os, "open", lambda *given: opened.append(given))
    with pytest.raises(BadInput, match=says) as refused:
        open_regular(name, name, 5, missing=lambda: ", look elsewhere")
    assert len(str(refused.value)) < 200
    assert not opened


@pytest.mark.parametrize("name", ["../secret", "link", "folder/../../secret", "inner/secret"])
def test_a_file_outside_is_not_opened(name: str, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("the password")
    folder = tmp_path / "data"
    (folder / "folder").mkdir(parents=True)
    (folder / "link").symlink_to(tmp_path / "secret")
    (folder / "inner").symlink_to(tmp_path)
    with pytest.raises(BadInput, match="lies outside of the folder") as refused:
        open_regular(folder / name, name, 100, inside=folder)
    assert "password" not in str(refused.value)


def test_a_file_above_the_limit_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "big").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(BadInput, match=r"big: has 1\.1e\+06 MB, more than the 16 MB that are read here"):
        read_yaml(tmp_path / "big")
    (tmp_path / "six").write_bytes(b"123456")
    with pytest.raises(BadInput, match="six: has 6 bytes, more than the 5 bytes"):
        read_regular(tmp_path / "six", "six", 5)


def test_a_file_that_changes_its_size_meanwhile_is_refused(tmp_path: Path) -> None:
    # the kernel's own files have the size 0 and content all the same
    with pytest.raises(BadInput, match="changed its size while it was read"):
        read_regular("/proc/self/status", "status", 1 << 20)


def test_a_pipe_is_no_yaml(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "rig.yaml")
    with pytest.raises(BadInput, match=r"rig\.yaml: is a pipe"):
        read_yaml(tmp_path / "rig.yaml")


def test_the_parser_stops_at_the_limit_of_values(monkeypatch: pytest.MonkeyPatch) -> None:
    composed = []
    compose = places._Loader.compose_node

    def counted(*given: Any) -> object:
        composed.append(1)
        return compose(*given)

    monkeypatch.setattr(places, "NODE_LIMIT", 1000)
    monkeypatch.setattr(places._Loader, "compose_node", counted)
    with pytest.raises(BadInput, match=r"^many.yaml:1: the file holds more than 1000 values$"):
        parse_yaml("a: [" + "1," * 5000 + "]\n", "many.yaml")
    assert len(composed) < 1100


def test_a_line_that_is_no_yaml_is_not_repeated_whole() -> None:
    with pytest.raises(BadInput, match="is not YAML") as refused:
        parse_yaml("a: [" + "," * 100_000 + "\n", "a.yaml")
    assert len(str(refused.value)) < 300
