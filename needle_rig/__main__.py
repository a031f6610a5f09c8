"""The installed command, and `python -m needle_rig`: Ctrl-C is heard before anything else is imported."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

STOPPED = 4


def main() -> None:
    """Run the command line. Ctrl-C says so at once, ends what runs in order, and leaves with exit code 4."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _leave)
    from needle_rig.cli.main import run

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _stopping_of(os.getpid()))
    sys.exit(run())


def _leave(_: int, __: FrameType | None) -> None:
    """Nothing is open yet, and imports that are cut short may turn the interrupt into another error."""
    _say("Stopped.")
    os._exit(STOPPED)


def _stopping_of(process: int) -> Callable[[int, FrameType | None], None]:
    def stop(_: int, __: FrameType | None) -> None:
        if os.getpid() == process:  # its children got the signal, too
            _say("stopping …")
        raise KeyboardInterrupt

    return stop


def _say(text: str) -> None:
    # a handler may not wait for a stream's lock, and nobody may read any more
    with suppress(OSError):
        os.write(2, f"{text}\n".encode())


if __name__ == "__main__":
    main()
