"""Files that are empty, cut, in another unit, mirrored or lack nodes: one clear list, no traceback.

By ``new``, which is given them, and by ``check`` of a case whose good file was replaced.
"""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from gmsh_files import gmsh_file
from mpi4py import MPI
from uff_files import mode_55, nodes_15, units_164

from fenics_joints.commands.check.run import check_case
from fenics_joints.commands.new.run import Source, run_new
from fenics_joints.commands.new.tests import TestFiles
from fenics_joints.errors import InputError
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.progress import Progress

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="new is for one process")

PLACES = np.array([[x, y, 0.01] for x in (0.0, 0.1) for y in (0.0, 0.03, 0.06)])
HEAD = "mode 1 [Hz],mode 2 [Hz],mode 3 [Hz]\n"


def silent(question, answer, check):
    check(answer)
    return answer


def plates(occ, unit=1.0):
    """Two plates, lapped, in millimetres."""
    for x, z in ((0, 0), (40, 10)):
        occ.addBox(*(unit * v for v in (x, 0, z, 100, 60, 10)))


def msh(path, scale=1.0, mirrored=False, order=1):
    """The same with gmsh's groups, in the drawing's numbers times a scale."""
    with gmsh_file(path, MeshSizeMax=40 * scale) as gmsh:
        plates(gmsh.model.occ, scale)
        gmsh.model.occ.fragment([(3, 1)], [(3, 2)])
        gmsh.model.occ.synchronize()
        for tag, name in ((1, "lower-alu"), (2, "upper-alu")):
            gmsh.model.addPhysicalGroup(3, [tag], name=name)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        if mirrored:
            gmsh.model.mesh.affineTransform([-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0])
    return path


def uff(path, places=PLACES, said=1e3, without=()):
    """A universal file in millimetres, which says 1000 / ``said`` of them."""
    nodes = {i: 1e3 * p for i, p in enumerate(places, 1) if i not in without}
    modes = "".join(
        mode_55(k, 60.0 * k, {i: (0, 0, (-1) ** (i * k) * i**k) for i in range(1, 7)})
        for k in (1, 2, 3)
    )
    path.write_text(units_164(said) + nodes_15(nodes) + modes, encoding="utf-8")
    return path


def shape_rows(n=6, unit="mm"):
    rows = [
        f"{1e3 * x},{1e3 * y},{1e3 * z},0,0,1,{i + 1},{(-1) ** i},{2 - i}"
        for i, (x, y, z) in enumerate(PLACES[:n])
    ]
    head = ",".join(f"{axis} [{unit}]" for axis in "xyz")
    return "\n".join([f"{head},dx,dy,dz,mode 1,mode 2,mode 3", *rows]) + "\n"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Good files, and a case of each kind beside its own copy."""
    folder = tmp_path_factory.mktemp("good")
    files = {
        "step": write_step(folder / "good.step", plates, labels=("lower alu", "upper alu")),
        "msh": msh(folder / "good.msh"),
        "uff": uff(folder / "good.uff"),
        "csv": folder / "good.csv",
        "shapes": folder / "good_shapes.csv",
    }
    files["csv"].write_text(HEAD + "60,120,180\n", encoding="utf-8")
    files["shapes"].write_text(shape_rows(), encoding="utf-8")
    for kind, file in files.items():
        own = folder / f"own_{kind}{file.suffix}"
        shutil.copy(file, own)
        found = run_new(folder / kind, *sources(files, kind, own), silent, Progress(silent=True))
        assert found.checked.errors == () and found.checked.notes == (), kind
    return folder, files


def sources(good, kind, file):
    """What `new` is given, one file of which is replaced."""
    tests = {
        "csv": TestFiles(frequencies=file),
        "uff": TestFiles(uff=(file,)),
        "shapes": TestFiles(frequencies=good["csv"], shapes=file),
    }.get(kind, TestFiles(uff=(good["uff"],)))
    if kind == "msh":
        return Source(msh=file), tests
    return Source(step=file if kind == "step" else good["step"]), tests


def text(path, content):
    path.write_text(content, encoding="utf-8")


def half(path, good):
    text(path, good.read_text(encoding="utf-8")[: good.stat().st_size // 2])


def metres(path, good):
    text(path, good.read_text(encoding="utf-8").replace(".MILLI.,.METRE.", "$,.METRE."))


def mirrored(path, good):
    write_step(path, lambda occ: plates(occ, -1.0))


def empty(path, good):
    text(path, "")


#: Kind, mistake, function that makes the file (path, good file), and the pattern of the message by
#: `new`, which is also that by `check` unless one is given; None: the command accepts the file.
BAD = [
    ("step", "cut", half, "truncated, expected END-ISO"),
    ("step", "metres", metres, "unit of their coordinates, or that of", "unit of its file right"),
    ("step", "mirrored", mirrored, r"outside the mesh.*\(-x, -y, -z\)", None),
    ("msh", "empty", empty, "not a gmsh .msh file"),
    ("msh", "cut", half, "gmsh cannot read it"),
    ("msh", "metres", lambda p, g: msh(p, 1e-3), None, "unit"),
    ("msh", "mirrored", lambda p, g: msh(p, mirrored=True), "mesh mirrored"),
    ("uff", "cut", half, "stops within a dataset|truncated"),
    ("uff", "metres", lambda p, g: uff(p, said=1.0), "mm and not m"),
    ("uff", "mirrored", lambda p, g: uff(p, PLACES * [-1, 1, 1]), r"\(-x, y, z\)"),
    ("uff", "fewer nodes", lambda p, g: uff(p, without=(2, 5)), "nodes 2, 5 of the 6"),
    ("shapes", "empty", empty, "0 rows"),
    ("shapes", "metres", lambda p, g: text(p, shape_rows(unit="m")), "mm and not m", None),
    ("shapes", "fewer rows", lambda p, g: text(p, shape_rows(5)), None, r"expected \(6, 3\)"),
]


@pytest.mark.parametrize("row", BAD, ids=lambda row: f"{row[0]} {row[1]}")
def test_a_bad_file(tmp_path, good, capfd, row):
    """The message names the file or the sensors and what was expected; libraries print nothing."""
    (_, files), (kind, _, make, by_new, *other) = good, row
    bad = tmp_path / f"bad{files[kind].suffix}"
    make(bad, files[kind])
    capfd.readouterr()
    try:
        found = run_new(tmp_path / "new", *sources(files, kind, bad), silent, Progress(silent=True))
        said = list(found.checked.errors)
    except InputError as error:
        said = [str(error)]
        assert not (tmp_path / "new").exists()
    assert (said == []) is (by_new is None), said
    expect(said, by_new)
    checked = checked_with(bad, good, kind)
    expect([*checked.errors, *checked.notes], other[0] if other else by_new)
    assert capfd.readouterr().out == ""


def checked_with(bad, good, kind):
    """What `check` says of a case with a bad file in place of its own."""
    folder, files = good
    own = folder / f"own_{kind}{files[kind].suffix}"
    shutil.copy(bad, own)
    try:
        return check_case(folder / kind, MPI.COMM_SELF, Progress(silent=True))
    finally:
        shutil.copy(files[kind], own)


def expect(said, pattern):
    """One line of what is said has the pattern."""
    if pattern is not None:
        assert any(re.search(pattern, line, re.DOTALL) for line in said), said


def test_several_bad_files(tmp_path, good):
    """All that is wrong, in one error."""
    _, files = good
    step, uff_file, csv = (tmp_path / name for name in ("a.step", "b.uff", "c.csv"))
    for path in (step, uff_file, csv):
        text(path, "")
    tests = TestFiles(uff=(uff_file,), frequencies=csv)
    with pytest.raises(InputError) as refused:
        run_new(tmp_path / "new", Source(step=step), tests, silent, Progress(silent=True))
    lines = str(refused.value).splitlines()
    assert lines[0] == "3 errors in the files:" and len(lines) == 4
    for said in ("a.step: not a STEP file", "b.uff: .*is empty", "c.csv: .*0 rows"):
        assert re.search(said, str(refused.value)), str(refused.value)
    missing = TestFiles(frequencies=tmp_path / "x.csv", shapes=tmp_path / "y.csv")
    with pytest.raises(InputError, match=r"(?s)x.csv: no such file.*y.csv: no such file"):
        source = Source(step=files["step"])
        run_new(tmp_path / "new", source, missing, silent, Progress(silent=True))


def test_check_reads_the_other_files_beside_a_bad_one(tmp_path, good):
    """Mistakes in drawing, frequencies and amplitude data are reported together."""
    folder, _ = good
    for name in ("own_step.step", "hz.csv", "levels.csv"):
        text(tmp_path / name, "")
    case = (folder / "step" / "case.toml").read_text(encoding="utf-8").replace("../", "")
    head = case.partition("[test]")[0]
    more = '[test]\nfrequencies = "hz.csv"\namplitude = { bending = "levels.csv" }\n'
    text(tmp_path / "case.toml", head + more)
    found = check_case(tmp_path, MPI.COMM_SELF, Progress(silent=True))
    for said in ("own_step.step: not a STEP file", "hz.csv: .*0 rows", "levels.csv"):
        expect(found.errors, said)
    assert found.test_words() == "not read"


def several_in(folder, kind):
    """A file with independent mistakes, and a fragment of the message on each."""
    path = folder / f"several.{kind}"
    if kind == "uff":
        modes = [
            mode_55(k, hz, dict.fromkeys(range(1, 7), (0, 0, 1.0)))
            for k, hz in ((1, 60), (2, -5), (3, 80))
        ]
        modes[2] = modes[2].replace("\n         6\n", "\n         5\n")
        uff(path)
        text(path, path.read_text(encoding="utf-8").partition("    55")[0][:-7] + "".join(modes))
        return path, ["dataset 4 (type 55): frequency -5", "dataset 5 (type 55): node 5 is there"]
    if kind == "csv":
        rows = [f"{10 * i},x{i},30" for i in range(1, 14)]
        text(path, "\n".join(["a [Hz],b [Hz],a [Hz]", *rows, "1,2", "1"]) + "\n")
        return path, [
            "column name 'a'",
            "row 15 has 2 cells; row 16 has 1 cells, expected 3",
            "row 2, column 'b [Hz]' = 'x1'",
            "= 'x10' and 3 more",
        ]
    msh(path, order=2)
    content = path.read_text(encoding="utf-8").replace('"lower-alu"', '"upper-alu"')
    text(path, content)
    return path, ["groups are named 'upper-alu'", "has elements of order 2"]


@pytest.mark.parametrize("kind", ["uff", "csv", "msh"])
def test_all_that_is_wrong_in_one_file(tmp_path, good, kind):
    """Its name once, and a line for each mistake, by new and by check."""
    _, files = good
    bad, wanted = several_in(tmp_path, kind)
    with pytest.raises(InputError) as refused:
        run_new(tmp_path / "new", *sources(files, kind, bad), silent, Progress(silent=True))
    said = str(refused.value)
    assert re.search(r"several\.\w+: \d errors:", said) and said.count("several.") == 1
    assert all(any(words in line for line in said.splitlines()[1:]) for words in wanted), said
    found = checked_with(bad, good, kind)
    assert all(words in "\n".join(found.errors) for words in wanted), found.errors
