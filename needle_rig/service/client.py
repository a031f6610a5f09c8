"""Talks to a daemon: one that runs already, or a private one that lives as long as the client."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import IO, cast

from needle_rig.errors import Aborted, BadInput, NeedleRigError, RigFault
from needle_rig.folders import temporary_folder
from needle_rig.records import JsonObject
from needle_rig.service.api.documents import Document, Message, Started, State
from needle_rig.service.api.endpoint import private_socket, sockets_for_client
from needle_rig.service.installed.installation import nobody_answers
from needle_rig.service.installed.systemd import LOG

_DAEMON = (sys.executable, "-m", "needle_rig", "daemon")
_PREFIX = "needle-rig-daemon-"
_TIMEOUT_S = 15.0
_START_TIMEOUT_S = 600.0
SAID_BYTES = 10_000
"""Of what a daemon says while it starts, passed on to the person who started it."""
_PATIENCE_S = 5.0
_END_TIMEOUT_S = 15.0
_AGAIN_S = 10.0
"""A daemon whose API process died has a new one long before."""
_AGAIN_EVERY_S = 0.05


class DaemonClient:
    """One daemon, by its socket."""

    def __init__(self, path: Path, process: subprocess.Popen[bytes] | None = None) -> None:
        self.path = path
        self._process = process
        self._lease: str | None = None
        self.version: str | None = None
        """Of the daemon's needle-rig, known since the lease; one that does not say it is older."""

    @property
    def private(self) -> bool:
        """Whether it is ours and ends with us."""
        return self._process is not None

    def let_go(self) -> None:
        """We need it no more: a private daemon ends now, while we do the rest."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()

    def state(self) -> State:
        """What the daemon says of itself."""
        return cast(State, self._ask("GET", "/state", again_s=_AGAIN_S))

    @contextmanager
    def lease(self, holder: str) -> Iterator[None]:
        """Be the one who commands, inside a with block; BadInput says who does when it is somebody else."""
        told = self._ask("POST", "/lease", {"holder": holder})
        self._lease, self.version = str(told["lease"]), cast("str | None", told.get("version"))
        try:
            yield
        finally:
            # it ends by itself where this fails, and a stop has ended it already
            with contextlib.suppress(NeedleRigError):
                self._ask("DELETE", "/lease")
            self._lease = None

    def compensate(self, order: Message) -> Started:
        """Start a run; raises BadInput or RigFault when it cannot start, Aborted when a stop came before."""
        return cast(Started, self._ask("POST", "/compensate", order))

    def command(self, name: str, order: Message | None = None) -> Started:
        """Give another order, such as `jog`; raises as `compensate`."""
        return cast(Started, self._ask("POST", f"/{name}", order or {}))

    def stop(self, reason: str) -> None:
        """Stop the drive in the next tick."""
        self._ask("POST", "/stop", {"reason": reason}, again_s=_AGAIN_S)

    @contextmanager
    def stream(self) -> Iterator[Iterator[Document]]:
        """Everything that happens from now on; the first document is the whole state.

        A connection that breaks is made again, and the state comes again; it ends when the daemon is gone.
        """
        from websockets.exceptions import ConnectionClosed, InvalidHandshake
        from websockets.sync.client import ClientConnection, unix_connect

        def connect() -> ClientConnection:
            open_ones.close()
            return open_ones.enter_context(
                unix_connect(
                    str(self.path), uri="ws://daemon/stream", max_size=None, compression=None, close_timeout=1
                )
            )

        def documents(connection: ClientConnection) -> Iterator[Document]:
            while True:
                with contextlib.suppress(ConnectionClosed):
                    for text in connection:
                        yield json.loads(text)
                try:
                    connection = connect()
                except (OSError, InvalidHandshake, EOFError):
                    return

        with contextlib.ExitStack() as open_ones:
            try:
                first = connect()
            except (OSError, InvalidHandshake, EOFError) as error:
                raise self._silent(error) from None
            yield documents(first)

    def _silent(self, error: Exception) -> RigFault:
        said = str(error) or type(error).__name__
        return RigFault(
            f"{self.path}: the daemon does not answer ({said}); look at its log, of a service: {LOG}"
        )

    def _ask(
        self, method: str, path: str, content: Message | None = None, *, again_s: float = 0.0
    ) -> JsonObject:
        """The daemon's answer; for `again_s` the question is repeated when the connection breaks."""
        import httpx

        deadline_s = time.monotonic() + again_s
        headers = {} if self._lease is None else {"Lease": self._lease}
        while True:
            try:
                with httpx.Client(
                    # no certificates on a local socket: reading their list takes longer than the answer
                    transport=httpx.HTTPTransport(uds=str(self.path), verify=False),
                    base_url="http://daemon",
                    timeout=_TIMEOUT_S,
                ) as client:
                    response = client.request(method, path, json=content, headers=headers)
                break
            except httpx.TransportError as error:
                if _nobody_there(error) or time.monotonic() > deadline_s:
                    raise self._silent(error) from None
                time.sleep(_AGAIN_EVERY_S)
        answer: JsonObject = response.json()
        if "error" in answer:
            raise failure(answer)
        return answer


def _nobody_there(error: BaseException | None) -> bool:
    """Whether no daemon listens; a queue that is full or a process that died is no reason to give up."""
    while error is not None and not isinstance(error, ConnectionRefusedError | FileNotFoundError):
        error = error.__cause__ or error.__context__
    return error is not None


def failure(told: Message) -> NeedleRigError:
    """The error that a daemon told, with its exit code."""
    kinds = {kind.exit_code: kind for kind in (BadInput, RigFault, Aborted)}
    return kinds.get(told.get("exit_code", RigFault.exit_code), RigFault)(told["error"])


def find_daemon(path: Path | None = None) -> DaemonClient | None:
    """The daemon at `path`, or at the usual places; None where nobody answers.

    Raises BadInput when one is there that this user may not talk to.
    """
    for candidate in sockets_for_client() if path is None else [path]:
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
                probe.connect(str(candidate))
        except PermissionError:
            raise BadInput(
                f"{candidate}: you may not talk to this daemon; join the socket's group, or give --socket"
            ) from None
        except OSError:
            continue
        return DaemonClient(candidate)
    return None


def the_daemon(path: Path | None = None) -> DaemonClient:
    """The running daemon; RigFault says where was looked when there is none."""
    found = find_daemon(path)
    if found is None:
        raise nobody_answers(sockets_for_client() if path is None else [path])
    return found


@contextmanager
def private_daemon(
    options: Sequence[str],
    meanwhile: Callable[[], None] = lambda: None,
    waiting: Callable[[str], AbstractContextManager[None]] = lambda _: nullcontext(),
) -> Iterator[DaemonClient]:
    """A daemon of our own, started with these command-line options and ended with the block.

    It holds the other end of a pipe: should this process die in whatever way, the daemon stops the drive and
    ends. `meanwhile` is called while it starts; when that takes long, the rest of the wait is inside a block
    `waiting(reason)`. Raises what the daemon says when it cannot start.
    """
    with temporary_folder(_PREFIX) as folder, tempfile.TemporaryFile("w+") as complaints:
        command = [*_DAEMON, f"--private={folder}", *options]
        # a session of its own: Ctrl-C in the terminal reaches the client alone, which stops the run in order
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=complaints, start_new_session=True
        )
        try:
            meanwhile()
            _wait_until_ready(process, complaints, waiting)
            yield DaemonClient(private_socket(folder), process)
        finally:
            _end(process)


def _wait_until_ready(
    process: subprocess.Popen[bytes],
    complaints: IO[str],
    waiting: Callable[[str], AbstractContextManager[None]],
) -> None:
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], _PATIENCE_S)
    if not ready:
        with waiting("the first start compiles the needle's equations"):
            ready, _, _ = select.select([process.stdout], [], [], _START_TIMEOUT_S)
    line = process.stdout.readline() if ready else b""
    if line:
        told: JsonObject = json.loads(line)
        if "error" in told:
            raise failure(told)
        sys.stderr.write(os.pread(complaints.fileno(), SAID_BYTES, 0).decode("utf-8", "replace"))
        return
    if not ready:
        raise RigFault(
            f"the daemon did not start within {_START_TIMEOUT_S:g} s; run `needle-rig daemon` to see why"
        )
    code = process.wait()
    complaints.seek(0)
    said = complaints.read().strip()
    if code == BadInput.exit_code and said:
        raise BadInput(said.splitlines()[-1])
    raise RigFault(f"the daemon ended while it started (exit {code}): {said or 'it said nothing'}")


def _end(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    with contextlib.suppress(BrokenPipeError):
        process.stdin.close()
    try:
        process.wait(_END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.wait()
    process.stdout.close()
