"""A page for each room, with the docstrings of what users import."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path

HEAD = """# API

What a user imports, room by room; a room imports only from those before it. Lengths, forces and
moduli are in SI units. Everything runs on any number of MPI ranks and raises
errors of `fenics_joints.errors`.

| room | |
|---|---|
"""


def write(source: Path) -> None:
    """Write `api/index.md` and a page for each room."""
    import fenics_joints

    folder = source / "api"
    folder.mkdir()
    rooms = [*fenics_joints._ROOMS, "errors"]
    rows, seen = "", {}
    for room in rooms:
        module = importlib.import_module(f"fenics_joints.{room}")
        first = " ".join((module.__doc__ or "").split("\n\n")[0].split()).replace("``", "`")
        rows += f"| [{room}]({room}.rst) | {first} |\n"
        (folder / f"{room}.rst").write_text(_page(room, module, seen), encoding="utf-8")
    contents = "\n".join(rooms)
    toc = f"\n```{{toctree}}\n:hidden:\n\n{contents}\n```\n"
    (folder / "index.md").write_text(HEAD + rows + toc, encoding="utf-8")


def _page(room: str, module, seen: dict[int, str]) -> str:
    name = f"fenics_joints.{room}"
    text = f"{room}\n{'=' * len(room)}\n\n.. automodule:: {name}\n   :no-members:\n\n"
    text += f".. currentmodule:: {name}\n\n"
    # `errors` is one file, of which all that it defines is public.
    own = [key for key, thing in vars(module).items() if getattr(thing, "__module__", "") == name]
    for member in getattr(module, "__all__", [key for key in own if not key.startswith("_")]):
        thing = getattr(module, member)
        first = seen.setdefault(id(thing), f"{name}.{member}")
        same = first != f"{name}.{member}"
        text += f"``{member}``: :py:obj:`{first}`\n\n" if same else _entry(name, member, thing)
    return text


def _entry(module: str, name: str, thing) -> str:
    if inspect.isclass(thing):
        return f".. autoclass:: {module}.{name}\n   :members:\n\n"
    if callable(thing):
        return f".. autofunction:: {module}.{name}\n\n"
    return f".. autodata:: {module}.{name}\n   :no-value:\n\n"
