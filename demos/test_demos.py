"""The demos, and the scripts of README and documentation."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI
from scipy.integrate import quad
from scipy.optimize import brentq

from fenics_joints.joint_laws import RichardAbbott

REPOSITORY = Path(__file__).resolve().parents[1]
DEMOS = sorted(Path(__file__).parent.glob("*/demo_*.py"))
#: Run whenever tests run; the others, of up to three minutes each, by `.ci/run` with `-m slow`.
QUICK = ("demo_bolted_beams", "demo_bolted_plates", "demo_random_field")
DOCS = sorted((REPOSITORY / "docs").glob("*.md"))

# They start ranks of their own.
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes itself")


def blocks(language: str, *pages: Path) -> list[str]:
    """The pages' blocks of code in a language; without pages, those of the documentation."""
    text = "".join(page.read_text(encoding="utf-8") for page in pages or DOCS)
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def numbers(text: str) -> list[float]:
    return [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?", text)]


def printed(text: str) -> list[tuple[float, float]]:
    """Numbers as printed, and how far each may be off: a percentage by one unit of its last digit,
    others by that, if they have decimals, by 2 % or by 0.02."""
    found = re.findall(r"(-?\d+(?:\.(\d+))?)( %)?", text)
    units = [10.0 ** -len(decimals) for _, decimals, _ in found]
    return [
        (float(n), 1.01 * (u if percent else max(u if d else 0.0, 2e-2, 2e-2 * abs(float(n)))))
        for (n, d, percent), u in zip(found, units, strict=True)
    ]


def edit(path: Path, *changes: tuple[str, str]) -> None:
    """Replace texts in a file, each of which must stand there once."""
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} is {text.count(old)} times in {path.name}"
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def without_undetermined(text: str) -> str:
    """Output but for the parameters that are said not to follow from the data."""
    return "\n".join(line for line in text.splitlines() if "not determined" not in line)


@pytest.mark.parametrize(
    "demo",
    [d if d.stem in QUICK else pytest.param(d, marks=pytest.mark.slow) for d in DEMOS],
    ids=lambda path: path.stem,
)
def test_demo(demo, run_script, tmp_path):
    """Each asserts a published number, draws its picture, and prints the same on two ranks."""
    one = run_script(demo, str(tmp_path / "one.png"))
    two = run_script(demo, str(tmp_path / "two.png"), ranks=2)
    for name in ("one.png", "two.png"):
        assert (tmp_path / name).read_bytes()[:4] == b"\x89PNG"
    one, two = without_undetermined(one), without_undetermined(two)
    assert re.sub(r"\d", "", one) == re.sub(r"\d", "", two)
    for a, b in zip(printed(one), printed(two), strict=True):
        assert abs(a[0] - b[0]) <= a[1], (a, b)


@pytest.mark.smoke
def test_form(run_script, tmp_path):
    """README's form, and the documentation's, give the stiffness that E A / h says.

    README's goes on to modes, which `test_scripts_print_what_their_page_shows` compares.
    """
    (whole,) = [b for b in blocks("python") if "uncoupled_layer" in b]
    (short,) = [b for b in blocks("python", REPOSITORY / "README.md") if "uncoupled_layer" in b]
    _, lift = whole.split("K.assemble()")
    start, _ = short.split("K.assemble()")
    path = tmp_path / "form.py"
    for script in (whole, f"import numpy as np\n{start}K.assemble()\n{lift}"):
        path.write_text(script, encoding="utf-8")
        found, by_hand = numbers(run_script(path).replace("E A / h", ""))
        assert found == pytest.approx(863e6 * 0.08 * 0.08 / 0.5e-3, rel=1e-5)
        assert by_hand == pytest.approx(found, rel=1e-5)


def test_page_preload(run_script, tmp_path):
    """Its bolted plates carry the bolt's force, and touch as receding contact does.

    From 25 to 27 kN the area grows by what its slopes at both ends say.
    """
    (script,) = [b for b in blocks("python") if "solve_preload(" in b]
    path, areas, slopes = tmp_path / "page_preload.py", [], []
    for newtons in ("27e3", "25e3"):
        path.write_text(script.replace("25e3", newtons), encoding="utf-8")
        _, radius, mean, force, _, area, _, slope = numbers(run_script(path))
        areas.append(area)
        slopes.append(slope)
    assert areas[0] - areas[1] == pytest.approx(sum(slopes), rel=0.03)
    assert areas[1] == pytest.approx(np.pi * (radius**2 - 6.75**2), rel=0.02)
    # Two independent studies of a loaded radius of 12 mm: 23.5 to 23.9 mm.
    assert 23.3 < radius < 24.2
    assert force == pytest.approx(25e3, abs=1e-3)
    assert mean * np.pi * (radius**2 - 6.75**2) == pytest.approx(25e3, rel=0.02)


def test_page_slip(run_script, tmp_path):
    """Between rigid plates the documentation's layer dissipates what its backbone says, on a coarse
    mesh as on any."""
    slip = blocks("python", REPOSITORY / "docs/slip.md")
    (script,) = [b for b in slip if "solve_quasi_static(" in b]
    path = tmp_path / "page_slip.py"
    path.write_text(script, encoding="utf-8")
    coarse = "element_size=0.02", "element_size=0.04, n_thickness=1"
    edit(path, ("69e9", "69e13"), coarse)
    dissipated, stored = numbers(run_script(path))
    backbone = RichardAbbott(168.13e6, 1.01e5, 5.7426e5, 2.5)
    area = 0.08 * 0.08
    strain = brentq(lambda a: backbone.value(a) - 3000 / area, 0, 0.1)
    # The first loading is a quarter of a loop; a whole one follows.
    loop = area * 0.5e-3 * float(backbone.dissipation(strain))
    assert 1e-3 * dissipated == pytest.approx(1.25 * loop, rel=0.04)
    # At the peak the layer has had the backbone's work, but for what it dissipated on the way.
    work = area * 0.5e-3 * quad(backbone.value, 0, strain)[0]
    assert 1e-3 * stored == pytest.approx(work - loop / 4, rel=0.04)


def test_page_effect(run_script, tmp_path):
    """Its own effect takes part in a diagnosis; on a coarse mesh, to be quick."""
    (page,) = [p for p in DOCS if p.stem == "own-effect"]
    (script,) = blocks("python", page)
    shutil.copytree(REPOSITORY / "demos" / "lap_plates", tmp_path / "case")
    few = 'effects = ["joint normal compliance"]\nsamples = 4\nmax_effects = 1'
    changes = ('element_size = "5 mm"', 'element_size = "20 mm"'), ("max_effects = 2", few)
    edit(tmp_path / "case" / "case.toml", *changes)
    path = tmp_path / "page_effect.py"
    path.write_text(script, encoding="utf-8")
    edit(path, ('"demos/lap_plates"', repr(str(tmp_path / "case"))))
    printed = dict(line.split(": ") for line in run_script(path).splitlines())
    assert set(printed) == {"sealant film", "joint normal compliance", "none of these", "no gap"}
    # What is surer than 99 % is shown as that, what is less than 1 % as that.
    shown = [numbers(text)[0] for text in printed.values()]
    assert min(shown) >= 1 and max(shown) <= 99 and 97 <= sum(shown) <= 104


@pytest.mark.slow
def test_page_model(run_script, tmp_path):
    """Its film, made soft along its plane on a mesh from DOLFINx, is what the diagnosis names."""
    (page,) = [p for p in DOCS if p.stem == "own-model"]
    (script,), (shown,) = blocks("python", page), blocks("text", page)
    path = tmp_path / "page_model.py"
    path.write_text(script, encoding="utf-8")
    printed = run_script(path)
    assert re.sub(r"[\d.]|\s", "", printed) == re.sub(r"[\d.]|\s", "", shown)
    # The first is a rounded percentage.
    (percent, *found), (expected, *others) = numbers(printed), numbers(shown)
    assert percent == pytest.approx(expected, abs=1) and found == pytest.approx(others, abs=0.02)
    assert "joint tangential compliance" in printed.splitlines()[0]


def test_page_frf(run_script, tmp_path):
    """Its slope of two shapes by the layer's thickness is that of remeshed layers."""
    (script,) = [b for b in blocks("python") if "shape_gradients(" in b]
    path = tmp_path / "page_frf.py"
    path.write_text(script, encoding="utf-8")
    shapes, slopes = run_script(path).split("\n", 1)
    assert numbers(shapes) == [40, 2, 2, 40, 2, 2, 3]
    h, step = 0.657e-3, 2e-2
    found = []
    for layer in (h * (1 - step), h * (1 + step)):
        edited = tmp_path / "remeshed.py"
        edited.write_text(script, encoding="utf-8")
        # The upper body, and the sensor on it, move with the layer's upper face.
        edit(
            edited,
            ("element_size=0.06", f"element_size=0.06, layer={layer!r}"),
            ("meshed=0.657e-3", f"meshed={layer!r}"),
            ('"h", 0.657e-3', f'"h", {layer!r}'),
            ("0.09, 0.13]", f"0.09, {0.13 + layer - h!r}]"),
            ("shape_gradients(modes, [6, 7], places)[..., 2])", "modes.at(places)[:, 6:8])"),
        )
        found.append(np.reshape(numbers(run_script(edited).split("\n", 1)[1]), (2, 2)))
    down, up = found
    down = down * np.sign(np.sum(up * down, axis=0))
    difference = (up - down) / (2 * step * h)
    slopes = np.reshape(numbers(slopes), (2, 2))
    turned = np.sign(np.sum(slopes * difference, axis=0))
    assert slopes * turned == pytest.approx(difference, rel=3e-3)


def test_page_mesh(run_script, tmp_path):
    """Its case of a mesh of one's own: bolts found, start from cone and roughness; modes.

    On springs less stiff all frequencies are lower.
    """
    (text,) = [b for b in blocks("toml") if "plates.msh" in b]
    _draw_plates(tmp_path / "plates.msh")
    command = tmp_path / "command.py"
    command.write_text("import runpy\nrunpy.run_module('fenics_joints', run_name='__main__')\n")
    found = []
    for law in ("", 'k_n = "3e11 Pa/m"\nk_t = "2.4e11 Pa/m"\n'):
        changed = text if not law else re.sub(r"roughness = .*\n", law, text)
        (tmp_path / "case.toml").write_text(changed, encoding="utf-8")
        run_script(command, "modes", str(tmp_path), "--json", str(tmp_path / "modes.json"))
        found.append(json.loads((tmp_path / "modes.json").read_text(encoding="utf-8")))
    first, soft = found
    assert [ring["centre_m"] for ring in first["rings"]] == [
        pytest.approx([x, 0.015, 0.008], abs=5e-4) for x in (0.02, 0.06)
    ]
    assert first["rigid_body_modes"] == 6 and first["size_m"] == pytest.approx([0.1, 0.03, 0.016])
    notes = " ".join(first["notes"])
    assert "within a factor of three" in notes and "half into each part" in notes
    # 5 mm across flats of M6, and 8 mm through a plate at 30 degrees; the pressure of 8 kN on it.
    outer, inner = 5e-3 + 8e-3 * np.tan(np.pi / 6), 3.3e-3
    pressure = 8e3 / np.pi / (outer**2 - inner**2)
    k_n = pressure / 0.5 / (np.sqrt(np.pi) * 1.6e-6)
    assert f"k_n = {k_n:.3g} Pa/m" in notes
    assert np.all(np.array(soft["frequencies_hz"][6:]) < np.array(first["frequencies_hz"][6:]))


def _draw_plates(path):
    """Two plates of 100 x 30 x 8 mm on each other over 80 mm, with two holes of 6.6 mm."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    plates = [(3, occ.addBox(0, 0, z, 80 + z * 2.5, 30, 8)) for z in (0, 8)]
    holes = [(3, occ.addCylinder(x, 15, -1, 0, 0, 18, 3.3)) for x in (20, 60)]
    plates, _ = occ.cut(plates, holes)
    occ.fragment(plates[:1], plates[1:])
    occ.synchronize()
    for number, name in enumerate(("lower", "upper"), start=1):
        gmsh.model.addPhysicalGroup(3, [number], number, name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 8)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 12)
    gmsh.model.mesh.generate(3)
    gmsh.write(str(path))
    gmsh.finalize()


def test_page_beams(run_script, tmp_path):
    """Functions of the documentation's beams, line by line, peak where its modes are."""
    (script,) = [b for b in blocks("python") if "BeamStructure(" in b]
    path = tmp_path / "page_beams.py"
    path.write_text(script, encoding="utf-8")
    modes, peaks = (numbers(part) for part in run_script(path).split("]", 1))
    # Its damping is small, and its lines are 1 Hz apart.
    assert len(modes) == 6
    assert peaks == pytest.approx(modes, abs=1.0)
