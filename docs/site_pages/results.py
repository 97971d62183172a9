"""The page with all keys of the JSON files, from ``fenics_joints/commands/results.toml``."""

from __future__ import annotations

from pathlib import Path

from fenics_joints.commands.results import result_keys

PAGE = Path(__file__).resolve().parents[1] / "json.md"
HEADINGS = {"common": "All commands", "bayes": "update --bayes", "plan": "diagnose --plan"}
HEAD = """# Keys of the JSON

`--json FILE.json` writes what a command found; `--out FOLDER` writes it beside the page and the
tables. Values are in SI units unless the key ends in another unit. `fenics-joints schema --of NAME`
prints the JSON schema of a command's results. The key `schema` has the version of the keys, which
rises when a key is removed or changes its meaning. `[number]` is a list, `{number}` an object with
any keys; `?` allows null.

Made by `./with-fenicsx python3 docs/outputs.py docs/json.md`.
"""


def page() -> str:
    """The page in Markdown."""
    text = HEAD
    for command, keys in result_keys().items():
        text += (
            f"\n## {HEADINGS.get(command, command)}\n\n| key | type | content |\n|---|---|---|\n"
        )
        for key, said in keys.items():
            kind, _, meaning = said.replace("|", "\\|").partition(": ")
            text += f"| `{key.replace('?', '')}` | {kind} | {meaning} |\n"
    return text
