"""The command line: every file of this folder that holds a `command` is a command of that name."""

from __future__ import annotations

import difflib
import errno
import importlib
import os
import sys
import traceback
from pathlib import Path

import click

from needle_rig.cli._groups import GROUPS, LOOKED_FOR
from needle_rig.cli._renamed import in_new_words
from needle_rig.errors import NeedleRigError
from needle_rig.version import VERSION

CRASHED = 70
"""Exit code of a defect in this program (EX_SOFTWARE), so that it is never mistaken for an answer."""

_DISK_FAULTS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS})
"""What a write to an open file can meet; its error does not name the file."""
_SHOWN_LETTERS = 200


class Commands(click.Group):
    """Commands found by file name; only the one that is called is imported."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 as click calls it
        """Names of the command files, with dashes for underscores."""
        return sorted(
            path.stem.replace("_", "-")
            for path in Path(__file__).parent.glob("*.py")
            if not path.stem.startswith("_") and path.stem != "main"
        )

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of this name, imported now; None when there is none."""
        if cmd_name not in self.list_commands(ctx):
            return None
        module = importlib.import_module(f"needle_rig.cli.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that `args` name, its options as spelt now. Raises UsageError with the nearest name."""
        word = args[0]
        if not word.startswith("-") and word not in self.list_commands(ctx):
            near = difflib.get_close_matches(word, self.list_commands(ctx), n=1)
            meant = LOOKED_FOR.get(word) or next(iter(near), None)
            told = "" if meant is None else f" Did you mean {meant}?"
            raise click.UsageError(f"there is no command {word!r}.{told}", ctx)
        name, command, rest = super().resolve_command(ctx, args)
        return name, command, rest if name is None else in_new_words(name, rest)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """The commands in groups, a line each; none is imported for it."""
        width = max(len(name) for lines in GROUPS.values() for name in lines)
        for title, lines in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), line) for name, line in lines.items()])


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="needle-rig")
def group() -> None:
    """Turns the torsion windup out of steerable needles, and holds the needle's model against measurements.

    \b
    Exit codes of all commands: 0 it ran to its end, 1 a check that you asked for
    failed, 2 bad use, 3 a fault of the rig or of a file, 4 stopped by a person,
    70 a defect of this program.
    """


def run(arguments: list[str] | None = None) -> int:
    """Run one command line; what goes wrong becomes one line on stderr and the exit code."""
    try:
        result = group.main(args=arguments, prog_name="needle-rig", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as help_page:
        click.echo(help_page.format_message())
        return 2
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "needle-rig"
        click.echo(f"{where}: {error.format_message()} See {where} --help.", err=True)
        return 2
    except click.ClickException as error:
        click.echo(error.format_message(), err=True)
        return 2
    except NeedleRigError as error:
        click.echo(str(error), err=True)
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("Stopped.", err=True)
        return 4
    except BrokenPipeError:
        # the reader of our output (head, less) has gone: keep the interpreter's last flush from complaining
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.filename is None and error.errno not in _DISK_FAULTS:
            traceback.print_exc()
            return CRASHED
        from needle_rig.config.places import show_path

        place = "" if error.filename is None else f"{show_path(error.filename)[:_SHOWN_LETTERS]}: "
        click.echo(f"{place}cannot be read or written: {error.strerror}; name another place", err=True)
        return NeedleRigError.exit_code
    except Exception:  # noqa: BLE001 - a defect must not leave with the exit code of a failed check
        traceback.print_exc()
        return CRASHED
    return result if isinstance(result, int) else 0


def main() -> None:
    """Run the command line of this process and end it."""
    sys.exit(run())
