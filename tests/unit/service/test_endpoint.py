import grp
import os
import socket
import stat
import threading
from pathlib import Path

import pytest

from needle_rig.errors import BadInput, RigFault
from needle_rig.service.api.endpoint import Made, listening, socket_for_daemon, sockets_for_client


def test_only_owner_and_group_may_use_it(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "daemon.sock"
    group = grp.getgrgid(os.getgid()).gr_name
    with listening(path, group):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
        assert path.stat().st_gid == os.getgid()
    assert not path.exists()


def test_a_second_daemon_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "daemon.sock"
    with (
        listening(path, None),
        pytest.raises(RigFault, match="another daemon listens there") as caught,
        listening(path, None),
    ):
        pass
    assert "\n" not in str(caught.value)
    with listening(path, None):
        pass


def test_what_a_killed_daemon_left_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "daemon.sock"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    assert path.exists()
    with listening(path, None) as listener, socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
        server, _ = listener.accept()
        server.close()


def test_a_group_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no-such-group"), listening(tmp_path / "s", "no-such-group"):
        pass


@pytest.mark.parametrize(
    "path", ["/proc/nowhere/daemon.sock", "{tmp}/" + "x" * 200], ids=["folder", "length"]
)
def test_a_place_that_cannot_be_used_is_bad_input(path: str, tmp_path: Path) -> None:
    with (
        pytest.raises(BadInput, match="choose --socket"),
        listening(Path(path.format(tmp=tmp_path)), None),
    ):
        pass


def test_where_it_is() -> None:
    assert socket_for_daemon({"RUNTIME_DIRECTORY": "/run/needle-rig"}) == Path("/run/needle-rig/daemon.sock")
    assert socket_for_daemon({"XDG_RUNTIME_DIR": "/run/user/7"}) == Path("/run/user/7/needle-rig/daemon.sock")
    assert sockets_for_client({"XDG_RUNTIME_DIR": "/run/user/7"}) == [
        Path("/run/user/7/needle-rig/daemon.sock"),
        Path("/run/needle-rig/daemon.sock"),
    ]
    assert sockets_for_client({}) == [socket_for_daemon({})]


def test_what_is_no_socket_is_never_deleted(tmp_path: Path) -> None:
    precious, link = tmp_path / "letter.txt", tmp_path / "link"
    precious.write_text("dear")
    link.symlink_to(precious)
    for path in (precious, link, tmp_path):
        with pytest.raises(BadInput, match="is no socket; choose another --socket"), listening(path, None):
            pass
    assert precious.read_text() == "dear"
    assert link.is_symlink()


def test_nothing_is_left_beside_the_socket(tmp_path: Path) -> None:
    with listening(tmp_path / "daemon.sock", None):
        assert [each.name for each in tmp_path.iterdir()] == ["daemon.sock"]
    assert not list(tmp_path.iterdir())
    with pytest.raises(BadInput), listening(tmp_path / "daemon.sock", "no-such-group"):
        pass
    assert not list(tmp_path.iterdir())


def test_the_socket_of_a_later_daemon_is_not_removed_by_an_earlier_one(tmp_path: Path) -> None:
    path = tmp_path / "daemon.sock"
    with socket.socket(socket.AF_UNIX) as earlier:
        earlier.bind(str(path))
        made = Made.at(path)
    with listening(path, None):
        made.remove()
        assert path.is_socket()


def test_many_who_start_at_once_leave_one(tmp_path: Path) -> None:
    path = tmp_path / "daemon.sock"
    won, refused = list[int](), list[int]()
    everybody = threading.Barrier(4)

    def start() -> None:
        everybody.wait()
        try:
            with listening(path, None):
                won.append(1)
                over.wait(20)
        except RigFault:
            refused.append(1)

    over = threading.Event()
    starting = [threading.Thread(target=start) for _ in range(4)]
    for each in starting:
        each.start()
    for each in starting[:]:
        while not won or len(refused) < 3:
            each.join(0.05)
            assert any(one.is_alive() for one in starting)
    over.set()
    for each in starting:
        each.join()
    assert (len(won), len(refused)) == (1, 3)
