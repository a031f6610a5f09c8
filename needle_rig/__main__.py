"""The `needle-rig` command, which `python -m needle_rig` is too.

It imports nothing before it can answer Ctrl-C: the command line takes part of a second to load.
"""

import sys


def main() -> None:
    """Entry point of the installed command."""
    try:
        from needle_rig.cli.main import main as command

        command()
    except KeyboardInterrupt:
        sys.stderr.write("\nStopped.\n")  # below the ^C that a terminal shows
        sys.exit(4)


if __name__ == "__main__":
    main()
