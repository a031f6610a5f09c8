"""The version of this package."""

VERSION = "0.2.0"


def differs(daemon: str | None) -> str | None:
    """What to tell a person whose daemon is of another version; None where it is of the same."""
    if daemon == VERSION:
        return None
    other = "an older needle-rig" if daemon is None else f"needle-rig {daemon}"
    next_step = "restart it when no run goes on; a service: sudo systemctl restart needle-rig"
    return f"the daemon runs {other}, and this is {VERSION}; {next_step}"
