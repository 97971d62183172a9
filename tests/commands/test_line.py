"""The command line as people expect it: help, typos, examples, and how much is said."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
import typer
from mpi4py import MPI
from typer.testing import CliRunner

from fenics_joints.cli import app
from fenics_joints.commands.line import EXAMPLES
from fenics_joints.progress import loudness, set_loudness

if MPI.COMM_WORLD.size > 1:
    pytest.skip("about one process", allow_module_level=True)


def all_commands(group=None, words=()):
    """Words and command of the app, of its groups and of all that is in them."""
    group = typer.main.get_command(app) if group is None else group
    yield list(words), group
    for name, command in getattr(group, "commands", {}).items():
        yield from all_commands(command, (*words, name))


COMMANDS = {" ".join(words): command for words, command in all_commands()}


@pytest.mark.smoke
@pytest.mark.parametrize("words", COMMANDS)
def test_every_help_has_an_example_and_nothing_is_cut_or_doubled(words):
    runner, command = CliRunner(), COMMANDS[words]
    shown = runner.invoke(app, [*words.split(), "-h"])
    assert shown.exit_code == 0
    assert shown.output == runner.invoke(app, [*words.split(), "--help"]).output
    assert f"fenics-joints {words}" in shown.output.partition("Example")[2]
    for cut in ("...\n", "…", "None", "\\[", "\x1b"):
        assert cut not in shown.output.replace("[ARGS]...\n", "")
    said = " ".join(shown.output.split())
    assert " ".join(command.help.partition("\n\n")[0].split()) in said
    for below in getattr(command, "commands", {}).values():
        assert " ".join(below.help.partition("\n\n")[0].split()) in said
    assert "-q, --quiet" in said and "-v, --verbose" in said


@pytest.mark.parametrize(
    "line", [line for name in [w.split(" ")[-1] for w in COMMANDS] for line in EXAMPLES[name]]
)
def test_every_example_can_be_typed(line):
    """Its options are those of its command, and the demos that it names are there."""
    words = shlex.split(line.partition(">")[0])
    command = typer.main.get_command(app)
    context = command.make_context("fenics-joints", list(words))
    while hasattr(command, "commands"):
        name, command, words = command.resolve_command(context, words)
        context = command.make_context(name, list(words), parent=context)
    for word in words:
        if word.startswith("demos/"):
            assert (Path(__file__).parents[2] / word).exists()


def test_a_typo_gets_what_was_meant():
    for typed, meant in (
        ("mods x", "modes"),
        ("database qery", "query"),
        ("modes x --jsn y", "--json"),
    ):
        ran = CliRunner().invoke(app, typed.split())
        assert ran.exit_code == 2 and "Did you mean" in ran.output
        assert meant in ran.output.partition("Did you mean")[2]
    nothing = CliRunner().invoke(app, ["xyzzy"])
    assert nothing.exit_code == 2 and "mean" not in nothing.output


def test_quiet_says_errors_only_and_verbose_how_long_steps_take(tmp_path, write_case, capfd):
    write_case(tmp_path)
    case, none, out = str(tmp_path), str(tmp_path / "none"), tmp_path / "modes.json"

    def run(*words):
        return CliRunner().invoke(app, [word for word in words if word])

    try:
        assert run("modes", case, "-q", "--json", str(out)).output == ""
        assert out.exists() and capfd.readouterr() == ("", "")
        assert run("modes", none, "-q", "--json", str(out)).exit_code == 1
        assert "no such file" in capfd.readouterr().err
        said = run("modes", case, "--verbose").output + capfd.readouterr().err
        assert "baseline model" in said and "GiB of memory" in said
        for step in ("building the model", "solving 14 modes"):
            (line,) = [s for s in said.splitlines() if s.startswith(step) and s.endswith(" s")]
            assert float(line.split()[-2]) >= 0
        for before, after in (("-qv", ""), ("", "-qv"), ("-q", "-v")):
            both = run(before, "modes", none, after)
            assert both.exit_code == 2 and "not both" in both.output
        for before, after, loud in (
            ("-v", "", "verbose"),
            ("-q", "-q", "quiet"),
            ("", "", "normal"),
        ):
            again = run(before, "modes", none, after, "--json", str(out))
            assert again.exit_code == 1 and loudness() == loud
    finally:
        set_loudness("normal")
