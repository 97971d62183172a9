"""The notebooks as pages: words, code and what it shows, run while the site is built."""

from __future__ import annotations

import base64
import os
from pathlib import Path

#: Seconds for a cell, on a busy machine.
SECONDS = 1800


def write(repository: Path, source: Path, run: bool) -> None:
    """Write `notebooks/<name>.md` for each of `docs/notebooks`.

    Args:
        repository: Where `docs/` is.
        source: The site's folder of sources.
        run: Run them, so that the pages have outputs; if a cell fails, so does the site.
    """
    import jupytext

    folder, names = source / "notebooks", []
    folder.mkdir()
    for script in sorted((repository / "docs" / "notebooks").glob("*.py")):
        notebook = jupytext.read(script, fmt="py:light")
        if run:
            _run(notebook, script.parent)
        parts = []
        for cell in notebook.cells:
            code = cell.cell_type == "code"
            parts.append(f"```python\n{cell.source}\n```" if code else cell.source)
            parts += [_shown(output, folder, script.stem) for output in cell.get("outputs", ())]
        (folder / f"{script.stem}.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")
        names.append(f"notebooks/{script.stem}")
    with (source / "notebooks.md").open("a", encoding="utf-8") as page:
        page.write("\n```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n")


def _run(notebook, where: Path) -> None:
    """Put the outputs into a notebook, by a kernel of its own."""
    from nbclient import NotebookClient

    os.environ["OMP_NUM_THREADS"] = "1"
    place = {"metadata": {"path": str(where)}}
    NotebookClient(
        notebook, timeout=SECONDS, startup_timeout=SECONDS, kernel_name="python3", resources=place
    ).execute()


def _shown(output, folder: Path, name: str) -> str:
    """An output as Markdown: a picture, else a table, else text; nothing of warnings."""
    if output.output_type == "stream":
        return "```text\n" + output.text.strip("\n") + "\n```" if output.name == "stdout" else ""
    data = output.get("data", {})
    if "image/png" in data:
        picture = f"{name}-{len(list(folder.glob('*.png')))}.png"
        (folder / picture).write_bytes(base64.b64decode(data["image/png"]))
        return f"![What the cell draws]({picture})"
    if "text/html" in data:
        return data["text/html"]
    return f"```text\n{data['text/plain']}\n```" if "text/plain" in data else ""
