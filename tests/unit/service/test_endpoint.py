import grp
import os
import socket
import stat
from pathlib import Path

import pytest

from needle_rig.errors import BadInput, RigFault
from needle_rig.service.endpoint import listening, socket_for_daemon, sockets_for_client


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
