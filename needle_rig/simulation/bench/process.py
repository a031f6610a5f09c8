"""The simulated rig as a process of its own, behind the ports that a real rig would use.

`python -m needle_rig.simulation.bench [--config FILE]` prints one JSON line with its ports, then runs until
its standard input ends. Lines on standard input make links fail: `torque|drive|hall|can` with
`unplug|silence|garble|freeze|fade|restore` or `delay MS`; others break the machine (bench_loop.MACHINE) or
restart the drive node (`drive reset`); `status` tells how it goes.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.folders import temporary_folder

if TYPE_CHECKING:
    from needle_rig.simulation.bench.bench_lines import Said

PREFIX = "needle-rig-bench-"
"""Of the temporary folders with the names of a bench's ports."""


def needs_bench(config: RigConfig) -> bool:
    """Whether a port of `config` is `auto`, that is, the bench's."""
    return "auto" in config.links.ports.values()


def with_ports(config: RigConfig, ports: Mapping[str, str], interface: str = "slcan") -> RigConfig:
    """`config` with a bench's `ports`; its CAN bus is of this `interface`."""
    changes: dict[str, dict[str, object]] = {}
    for link, place in ports.items():
        if link == "can":
            changes[link] = {"interface": interface, "channel": place}
        elif link == "hall":
            changes[link] = {"port": place}
        else:
            address, rdt_port, http_port = place.split(":")
            changes[link] = {"address": address, "rdt_port": int(rdt_port), "http_port": int(http_port)}
    sections = {link: getattr(config.links, link).model_copy(update=new) for link, new in changes.items()}
    return config.model_copy(update={"links": config.links.model_copy(update=sections)})


class Bench:
    """A bench that runs as a child of this process and dies with it."""

    def __init__(
        self, process: subprocess.Popen[bytes], ports: dict[str, str], folder: contextlib.ExitStack
    ) -> None:
        self._process = process
        self._folder = folder
        self._text = b""
        self.ports = ports
        """Where the links are: `can`, `hall`, and `torque` of a sensor on the network."""

    def configured(self, config: RigConfig) -> RigConfig:
        """`config` with this bench's ports where it says `auto`."""
        auto = [key.partition(".")[0] for key, port in config.links.ports.items() if port == "auto"]
        return with_ports(config, {link: self.ports[link] for link in auto})

    def tell(self, line: str) -> None:
        """Send a control line, such as `torque freeze`."""
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")
        self._process.stdin.flush()

    def harm(self, link: str, fault: str, timeout_s: float = 10.0) -> float:
        """Let a link fail (or `restore` it); gives when it did, on the monotonic clock, in seconds."""
        self.tell(f"{link} {fault}")
        wanted = {"event": "fault", "link": link, "fault": fault}
        said = self.wait_for(lambda said: wanted.items() <= said.items(), timeout_s)
        return float(said["time_s"])

    def heard(self, timeout_s: float) -> Said | None:
        """The next thing that the bench says; None when it says nothing for `timeout_s`.

        Raises RigFault when the bench is gone.
        """
        assert self._process.stdout is not None
        deadline_s = time.monotonic() + timeout_s
        while b"\n" not in self._text:
            ready, _, _ = select.select(
                [self._process.stdout], [], [], max(deadline_s - time.monotonic(), 0.0)
            )
            if not ready:
                return None
            chunk = os.read(self._process.stdout.fileno(), 65536)
            if not chunk:
                raise RigFault(f"the simulated rig ended (exit {self._process.wait()})")
            self._text += chunk
        line, _, self._text = self._text.partition(b"\n")
        said: Said = json.loads(line)
        return said

    def wait_for(self, wanted: Callable[[Said], bool], timeout_s: float) -> Said:
        """The next thing said that is `wanted`; others are dropped. Raises TimeoutError."""
        deadline_s = time.monotonic() + timeout_s
        while (said := self.heard(max(deadline_s - time.monotonic(), 0.0))) is not None:
            if wanted(said):
                return said
        raise TimeoutError(f"the bench did not say it within {timeout_s:g} s")

    def wait_until_ready(self, timeout_s: float) -> None:
        """Wait until the ports are there.

        The first start on a machine compiles the solver, which takes a quarter of a minute. Raises BadInput
        or RigFault with what the child had to say. Blocks: from a running loop, use a thread.
        """
        said = self.heard(timeout_s)
        if said is None:
            raise RigFault(f"the simulated rig did not start within {timeout_s:g} s")
        if "error" in said:
            raise (BadInput if said["exit_code"] == BadInput.exit_code else RigFault)(said["error"])
        self.ports = {name: said[name] for name in ("can", "hall", "torque") if name in said}

    def kill(self) -> None:
        """End it at once, whatever it does; `close` takes away the rest."""
        self._process.kill()

    @property
    def pid(self) -> int:
        """Process id of the bench."""
        return self._process.pid

    def close(self) -> None:
        """End the bench and remove its ports; safe to call twice."""
        process = self._process
        if process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
        try:
            process.wait(2.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
        self._folder.close()


def start(config: RigConfig, timeout_s: float = 120.0) -> Bench:
    """Start the bench of `config` as a child and wait until its ports are there: `spawn`, then wait."""
    bench = spawn(config)
    try:
        bench.wait_until_ready(timeout_s)
    except BaseException:
        bench.close()
        raise
    return bench


def spawn(config: RigConfig) -> Bench:
    """Start the bench of `config` as a child that gets ready by itself."""
    folder = contextlib.ExitStack()
    ports = str(folder.enter_context(temporary_folder(PREFIX)))
    command = [sys.executable, "-m", "needle_rig.simulation.bench", "--config", "-", "--child-in", ports]
    # A session of its own: Ctrl-C in the terminal stops the sequence, not the rig under it. When this process
    # ends in whatever way, so does the child's standard input, and with it the child, which then removes the
    # folder in this process's place.
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
    bench = Bench(process, {}, folder)
    with contextlib.suppress(BrokenPipeError):  # it is gone, which is reported when it is waited for
        bench.tell(config.model_dump_json())
    return bench


def _read_config(name: str | None) -> RigConfig:
    from needle_rig.config.loader import load_rig_config

    if name == "-":
        line = b""
        while not line.endswith(b"\n") and (byte := os.read(0, 1)):
            line += byte
        if not line.endswith(b"\n"):  # whoever started this has gone
            sys.exit(0)
        return RigConfig.model_validate_json(line)
    return load_rig_config(name)


@contextmanager
def _ports_folder(named: str | None, parents: str | None) -> Iterator[Path]:
    """Where the ports' names go: a folder `named` by a person, the parent's, or a temporary one."""
    if named is not None:
        yield Path(named)
    elif parents is not None:
        try:
            yield Path(parents)
        finally:
            shutil.rmtree(parents, ignore_errors=True)
    else:
        with temporary_folder(PREFIX) as folder:
            yield folder


def main(arguments: list[str] | None = None) -> int:
    """Run the bench; see the module's description."""
    import argparse

    parser = argparse.ArgumentParser(prog="python -m needle_rig.simulation.bench", description=__doc__)
    parser.add_argument(
        "--config", help="rig file; default: config/rig.yaml; -: one JSON line on standard input"
    )
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--ports", help="folder for the names of the ports; default: a temporary one")
    place.add_argument("--child-in", help=argparse.SUPPRESS)
    parser.add_argument("--can", help="CAN interface to put the nodes on, such as vcan0; default: slcan")
    parser.add_argument("--keep", action="store_true", help="go on when standard input ends")
    options = parser.parse_args(arguments)

    from needle_rig.simulation.bench.bench_loop import BenchLoop, be_urgent, speak

    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: sys.exit(0))
    say = speak(1)
    with _ports_folder(options.ports, options.child_in) as ports, contextlib.ExitStack() as stack:
        try:
            from needle_rig.simulation.build import build_plant

            config = _read_config(options.config)
            loop = BenchLoop(config, build_plant(config), ports, say, options.can)
        except NeedleRigError as error:
            say({"error": str(error), "exit_code": error.exit_code})
            return error.exit_code
        stack.callback(loop.close)
        said: Said = {"can": loop.ports["can"], "hall": loop.ports["hall"]}
        if "torque" in loop.ports:
            said["torque"] = loop.ports["torque"]
        say(said)
        be_urgent()
        with contextlib.suppress(KeyboardInterrupt):
            loop.run(0, end_with_control=not options.keep)
    return 0
