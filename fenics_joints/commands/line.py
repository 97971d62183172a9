"""The command line as people expect it: ``-h``, ``-q`` and ``-v``, what a typo was meant to be, and
an example for each command."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable

import click
import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from fenics_joints.commands.arguments import case_options
from fenics_joints.progress import set_loudness

#: What the help of each command shows, by the words that call it.
EXAMPLES = {
    "": ("modes demos/dumbbell", "diagnose demos/lap_plates --report page.html"),
    "add": (
        "database add --db own.db --csv rows.csv",
        "database add --db own.db --bolt M12 --force '50 kN' --radius '43 mm'",
    ),
    "check": ("check demos/lap_plates --report check.html",),
    "database": ("database query --bolt M12 --torque '120 N·m' --thickness '25 mm'",),
    "diagnose": (
        "diagnose demos/lap_plates --report diagnosis.html",
        "diagnose demos/lap_plates --plan",
    ),
    "harmonic": ("harmonic demos/lap_beam/nonlinear.toml --report responses.html",),
    "modes": ("modes demos/dumbbell --vtx modes.bp", "modes my_case -n 30 --report modes.html"),
    "new": ("new my_case --step assembly.step --frequencies frequencies.csv",),
    "preload": ("preload demos/c_beam --vtx contact.xdmf",),
    "query": ("database query --bolt M12 --torque '120 N·m' --thickness '25 mm'",),
    "schema": ("schema > case.schema.json",),
    "show": ("database show --leave-one-out", "database show --db own.db --csv rows.csv"),
    "sweep": ("database sweep --db own.db --bolt M12 --force '25, 50 kN' --thickness '20 mm'",),
    "update": (
        "update demos/lap_plates --report update.html",
        "update my_case --bayes --keep chains.nc",
    ),
    "web": ("database web --db own.db",),
}


def new_app(name: str, help: str) -> typer.Typer:
    """An app whose commands all have ``-h``, ``-q``, ``-v`` and an example in their help.

    Its help is plain text: frames of rich cut what does not fit, and differ with the version.

    Args:
        name: Of its examples in `EXAMPLES`.
        help: What its help begins with.
    """
    names = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
    return _App(
        cls=_Group,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        help=help,
        epilog=_examples(name),
        context_settings=names,
    )


class _App(typer.Typer):
    def command(self, name=None, *, cls=None, **settings):
        return super().command(name, cls=cls or _Command, **settings)


class _Plain:
    """Help of which nothing is cut."""

    def get_short_help_str(self, limit: int = 45) -> str:
        """The first paragraph, whole: the list of commands wraps it."""
        return " ".join((self.help or "").split("\n\n")[0].split())

    def format_help(self, ctx, formatter) -> None:
        super().format_help(ctx, formatter)
        # Some versions of typer escape [required] for rich, although it does not print this.
        formatter.buffer[:] = [part.replace("\\[", "[") for part in formatter.buffer]


class _Command(_Plain, TyperCommand):
    """A command with the options that all have."""

    def __init__(self, name, *, params=None, epilog=None, **settings):
        super().__init__(
            name,
            params=[*(params or ()), *case_options(name, params or ()), *_how_much()],
            epilog=epilog or _examples(name),
            **settings,
        )


class _Group(_Plain, TyperGroup):
    """Commands, the nearest of which is suggested for one that is not there.

    It has the options that all commands have, too: ``-v`` stands before a command or after it.
    """

    def __init__(self, *, params=None, **settings):
        super().__init__(params=[*(params or ()), *_how_much()], **settings)

    def main(self, *args, standalone_mode: bool = True, **settings):
        """Run it; a wrong line ends as other errors do, with exit code 2."""
        try:
            code = super().main(*args, standalone_mode=False, **settings)
        except click.ClickException as error:
            code, ctx = error.exit_code, getattr(error, "ctx", None)
            if type(error).__name__ == "NoArgsIsHelpError":  # since click 8.2
                error.show()
            else:
                typer.echo(f"error: {_wrong(error)}", err=True)
                if ctx is not None:
                    typer.echo(f"Try '{ctx.command_path} -h' for help.", err=True)
        except click.Abort:
            typer.echo("stopped", err=True)
            code = 1
        sys.exit(code if isinstance(code, int) else 0)

    def resolve_command(self, ctx, args):
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            near = difflib.get_close_matches(name, self.commands, n=2, cutoff=0.5)
            meant = f" Did you mean {' or '.join(near)}?" if near else ""
            ctx.fail(f"No such command {name!r}.{meant}")
        return super().resolve_command(ctx, args)


def _wrong(error: click.ClickException) -> str:
    """What is wrong with a line, and what may have been meant."""
    if isinstance(error, click.NoSuchOption):
        near = " or ".join(list(error.possibilities or ())[:2])
        return f"no such option: {error.option_name}{near and f'. Did you mean {near}?'}"
    words = error.format_message()
    return words[:1].lower() + words[1:]


def _examples(name: str) -> str | None:
    lines = EXAMPLES.get(name)
    if lines is None:
        return None
    head = "Example:" if len(lines) == 1 else "Examples:"
    return "\b\n" + "\n".join([head, *(f"  fenics-joints {line}" for line in lines)])


def _how_much() -> list[TyperOption]:
    """The options ``-q`` and ``-v``, which set the loudness and are no argument of the command."""
    settings = {"is_flag": True, "default": False, "expose_value": False}
    return [
        TyperOption(
            param_decls=["-q", "--quiet"],
            callback=_sets("quiet"),
            help="Say nothing but errors; results go to files.",
            **settings,
        ),
        TyperOption(
            param_decls=["-v", "--verbose"],
            callback=_sets("verbose"),
            help="Say the seconds of every step, each part of it, and the memory used.",
            **settings,
        ),
    ]


def _sets(loudness: str) -> Callable:
    def callback(ctx, param, wanted: bool) -> bool:
        given = ctx.meta.setdefault(__name__, [])
        given += [loudness] * bool(wanted)
        if len(set(given)) > 1:
            raise typer.BadParameter("expected -q or -v, not both")
        set_loudness(given[0] if given else "normal")
        return wanted

    return callback
