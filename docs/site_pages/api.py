"""A page for each room: an example from a script that tests run, and the public docstrings."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from textwrap import indent

REPOSITORY = Path(__file__).resolve().parents[2]
#: Example of each room: a page or script of the repository, and words by which its blocks of code,
#: or its cells, are found.
EXAMPLES = {
    "forms": ("docs/forms.md", "uncoupled_layer("),
    "meshes": ("docs/own-mesh.md", "read_msh("),
    "structure": ("docs/own-mesh.md", "TaggedMesh("),
    "modal": ("docs/forms.md", "modes.gradients("),
    "joint_laws": ("docs/slip.md", "RichardAbbott("),
    "preload": ("docs/preload.md", "solve_preload("),
    "response": ("docs/functions.md", "solve_frf("),
    "measurements": ("docs/own-data.md", "MeasuredFRFs("),
    "reduction": ("demos/bolted_beams/demo_random_field.py", "narrow(beams"),
    "beams": ("docs/beams.md", "BeamStructure("),
    "interfaces": ("docs/own-law.md", "reduce_layers("),
    "harmonic": ("demos/half_lap_beam/demo_half_lap_beam.py", "solve_backbone("),
    "transient": ("tests/transient/test_transient.py", "def linear", "ring_down_of_a_linear"),
    "random_fields": ("demos/bolted_beams/demo_random_field.py", "propagate_samples(forward"),
    "updating": ("docs/updating.md", "update(structure"),
    "bayes": ("demos/bolted_beams/demo_bayes.py", "sample_hierarchy(data"),
    "database": ("demos/engraving_machine/demo_engraving_machine.py", "seed_database()"),
    "case": ("docs/cluster.md", "load_case("),
    "diagnosis": ("docs/own-model.md", "diagnose(baseline"),
    "report": ("docs/notebooks/preload.py", "pressure_profile(state)"),
    "commands": ("docs/notebooks/modes.py", "run_modes("),
    "matrices": ("docs/own-matrices.md", "MatrixStructure("),
}

HEAD = """# API

Public names, room by room; a room imports only from the rooms before it. The how-to pages come
first: each page of the API begins with an example from one of them, from a demo or from a test.
Lengths, forces and moduli are in SI units. Everything runs on any number of MPI ranks and raises
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
    rooms.insert(rooms.index("beams"), "matrices")
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
    text += example(*EXAMPLES[room]) if room in EXAMPLES else ""
    # `errors` is one file, of which all that it defines is public.
    own = [key for key, thing in vars(module).items() if getattr(thing, "__module__", "") == name]
    for member in getattr(module, "__all__", [key for key in own if not key.startswith("_")]):
        thing = getattr(module, member)
        first = seen.setdefault(id(thing), f"{name}.{member}")
        same = first != f"{name}.{member}"
        text += f"``{member}``: :py:obj:`{first}`\n\n" if same else _entry(name, member, thing)
    return text


def example(file: str, *words: str) -> str:
    """Blocks of a page, or cells of a script, that have these words, and where they are from."""
    import jupytext

    text = (REPOSITORY / file).read_text(encoding="utf-8")
    if file.endswith(".md"):
        found = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    else:
        cells = jupytext.reads(text, fmt="py:light").cells
        found = [cell.source for cell in cells if cell.cell_type == "code"]
    code = [next((block for block in found if each in block), "") for each in words]
    if not all(code):
        raise ValueError(f"{file} has no code with {words}: docs/site_pages/api.py")
    folder, _, name = file.rpartition(".")[0].partition("/")
    page = {"docs": f"/{name}", "demos": f"/gallery/{name.rpartition('/')[2]}"}.get(folder)
    where = f":doc:`{page}`" if page else f"``{file}``"
    block = indent("\n\n".join(code), "   ")
    return f".. rubric:: Example\n\nFrom {where}:\n\n.. code-block:: python\n\n{block}\n\n"


def _entry(module: str, name: str, thing) -> str:
    if inspect.isclass(thing):
        return f".. autoclass:: {module}.{name}\n   :members:\n\n"
    if callable(thing):
        return f".. autofunction:: {module}.{name}\n\n"
    return f".. autodata:: {module}.{name}\n   :no-value:\n\n"
