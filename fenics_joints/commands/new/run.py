"""The ``new`` command: from the files of a test lab to a case that runs."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from mpi4py import MPI
from rich.console import Console

from fenics_joints.commands.check.run import Checked, check_case, check_document
from fenics_joints.commands.new.draft import MATERIALS, Ask, Draft, Remark, direction, guess
from fenics_joints.commands.new.matrices import matrices_draft
from fenics_joints.commands.new.sources import Source
from fenics_joints.commands.new.tests import TestDraft, TestFiles, draft_test
from fenics_joints.commands.new.text import text_of
from fenics_joints.errors import InputError, Problems, member
from fenics_joints.files import is_file, shown_path, writable_folder, write_text
from fenics_joints.meshes.cad_survey import survey_step
from fenics_joints.progress import Progress
from fenics_joints.report.terminal import say, show


@dataclass(frozen=True, eq=False)
class Written:
    """A case that was written.

    Attributes:
        draft: Its structure.
        test: Its test.
        checked: What `check` says of it.
        copied: Files that were copied beside it.
    """

    draft: Draft
    test: TestDraft
    checked: Checked
    copied: tuple[Path, ...]


def run_new(
    folder: Path,
    source: Source,
    tests: TestFiles,
    ask: Ask,
    progress: Progress,
    material: str = "steel",
) -> Written:
    """Look into files and write ``case.toml`` into a folder. Needs one process.

    Files in the folder or beside it are referred to, others copied. Of several cases that the
    files may mean, the first in which `check` finds no error is written.

    Args:
        folder: Made if it is not there.
        source: The structure.
        tests: The test.
        ask: Asks the user.
        progress: Told what is being done.
        material: Of parts of which nothing says it.

    Raises:
        InputError: If there is a case already, or for what is wrong in a file.
    """
    member("material", material, MATERIALS)
    doors = (source.step, source.msh, source.matrices, source.builder)
    given = [option for option in doors if option is not None]
    if len(given) != 1:
        raise InputError(
            "expected one of --step FILE, --mesh FILE, --matrices FILE, --beams and --builder NAME"
        )
    if source.preload and source.step is None:
        raise InputError("--preload is for --step FILE; a .msh file names its faces itself")
    case = folder / "case.toml"
    if case.exists():
        raise InputError(f"{shown_path(case)}: is there already; expected a folder without a case")
    problems = Problems()
    for path in (source.step, source.msh, *(source.matrices or ()), *tests.all()):
        if path is not None and not is_file(path):
            problems.add(f"{shown_path(path)}: no such file")
    problems.check()
    progress.step("looking into the files")

    def reached(words: str, done: int, of: int) -> None:
        progress.reach(done, f"of {of} {words}")

    files, survey, drafts = _Files(folder), None, iter(())
    if source.step is not None:
        survey = problems.tried(lambda: survey_step(source.step, reached))
    test = problems.tried(
        lambda: draft_test(tests, files.name, ask, lambda: source.extents(survey))
    )
    if source.step is None or survey is not None:
        path = source.step or source.msh
        file, places = "" if path is None else files.name(path), (test or TestDraft()).places
        drafts = source.drafts(survey, file, places, material, ask)
        if source.matrices:
            given = source.matrices, files.name, places, material, ask
            drafts = (matrices_draft(*one) for one in [given])
        first = problems.tried(lambda: next(drafts))  # a mesh is read here
        drafts = chain([] if first is None else [first], drafts)
    problems.check()
    made = not folder.exists()
    writable_folder(folder, "FOLDER")
    try:
        return _first_good(folder, drafts, test, files, progress)
    except BaseException:
        case.unlink(missing_ok=True)
        files.undo()
        if made and not any(folder.iterdir()):
            folder.rmdir()
        raise


def _first_good(folder: Path, drafts, test: TestDraft, files: _Files, progress) -> Written:
    """Write the first case that has no errors, or else the first of all."""
    files.copy()
    tried = []
    for draft in drafts:
        text = text_of(folder.resolve().name, draft, test)
        write_text(folder / "case.toml", text)
        checked = check_case(folder, MPI.COMM_SELF, progress, solve=False)
        tried.append((text, Written(draft, test, checked, tuple(files.copied))))
        if not checked.errors:
            return _with_directions(folder, tried[-1][1])
    text, written = tried[0]
    write_text(folder / "case.toml", text)
    return written


def _with_directions(folder: Path, written: Written) -> Written:
    """Write the case again with the directions that the mesh gives to thin parts."""
    draft, parts = written.draft, {}
    for name, part in written.draft.tables["parts"].items():
        own, ways = {}, written.checked.directions.get(name)
        if ways is not None:
            own["normal"] = guess(direction(ways[0]), "of the thickness: the least extent")
            own["across"] = guess(direction(ways[1]), "of the width: the next")
        parts[name] = Remark({**part.value, **own}, part.words)
    draft = replace(draft, tables={**draft.tables, "parts": parts})
    write_text(folder / "case.toml", text_of(folder.resolve().name, draft, written.test))
    return replace(written, draft=draft)


class _Files:
    """Names of files in a case: relative paths of near files, and names of copies of far ones."""

    def __init__(self, folder: Path):
        self.folder, self.near = folder.resolve(), folder.resolve().parent
        self._wanted: dict[Path, Path] = {}
        self.copied: list[Path] = []

    def name(self, path: Path) -> str:
        """The name of a file in the case; to be copied if it is far."""
        path = path.resolve()
        if path.is_relative_to(self.folder) or path.parent == self.near:
            return Path(os.path.relpath(path, self.folder)).as_posix()
        for source, copy in self._wanted.items():
            if source != path and copy.name == path.name:
                raise InputError(f"{source} and {path}: expected files of different names")
        self._wanted[path] = self.folder / path.name
        return path.name

    def copy(self) -> None:
        """Copy the files that are far."""
        for source, copy in self._wanted.items():
            if copy.exists():
                raise InputError(f"{shown_path(copy)}: is there already; expected no such file")
            shutil.copyfile(source, copy)
            self.copied.append(copy)

    def undo(self) -> None:
        """Delete the copies."""
        for copy in self.copied:
            copy.unlink(missing_ok=True)


def show_new(console: Console, folder: Path, written: Written) -> None:
    """Print what was found, what was guessed, and what `check` says."""
    say(console, f"{shown_path(folder / 'case.toml')}: written", "bold")
    for words in (*written.draft.found, *written.test.found):
        say(console, words)
    for path in written.copied:
        say(console, f"copied {shown_path(path)}")
    for question in (*written.draft.questions, *written.test.questions):
        say(console, f"? {question}", "yellow")
    console.print()
    show(console, check_document(written.checked))
