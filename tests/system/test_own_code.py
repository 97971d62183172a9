"""Laws, effects and meshes of a user's own, as docs/own-package.md shows them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case, own_code
from fenics_joints.errors import InputError
from fenics_joints.modal import solve_modes

PAGE = Path(__file__).resolve().parents[2] / "docs" / "own-package.md"
WORN = """
from fenics_joints.forms import slider
from fenics_joints.joint_laws import JointLaw


class Slider(JointLaw):
    units = {"stiffness": "Pa", "strength": "Pa"}

    def state_size(self, n_slip):
        return n_slip

    def element(self, normal, slip, state, p):
        return ufl.as_ufl(0.0), *slider(slip, state, p["stiffness"], p["strength"])
"""


def blocks() -> dict[str, str]:
    """The page's module, case and project file."""
    found = re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    code, case, project = (text for kind, text in found if kind in ("python", "toml"))
    return {"sealed_joints.py": code, "case.toml": case, "pyproject.toml": project}


@pytest.fixture
def folder(tmp_path):
    """A folder with them, and nothing allowed before or after."""
    for name, text in blocks().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    yield tmp_path
    own_code.forbid_code()
    sys.modules.pop("sealed_joints", None)


def changed(folder: Path, name: str, *pairs: tuple[str, str], more: str = "") -> Path:
    text = (folder / "case.toml").read_text(encoding="utf-8")
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    path = folder / name
    path.write_text(text + more, encoding="utf-8")
    return path


def elastic(path: Path, allow_code: bool = True, **given: float) -> np.ndarray:
    structure = build_structure(load_case(path, allow_code=allow_code), MPI.COMM_WORLD)
    values = {f"lap.{key}": value for key, value in given.items()}
    return solve_modes(structure, values, n_modes=11).frequencies_hz[6:]


OWN = 'law = "sealed_joints:tilted"\nvalues = { k_n = "1e12 Pa/m", k_t = "4e11 Pa/m", tilt = 0.1 }'
SPRINGS = 'law = "springs"\nk_n = "1e12 Pa/m"\nk_t = "4e11 Pa/m"'


def test_a_case_runs_no_code_that_is_not_allowed(folder):
    (folder / "sealed_joints.py").write_text("raise SystemExit('ran')", encoding="utf-8")
    with pytest.raises(
        InputError, match="joints.lap: sealed_joints:tilted: .*only with --allow-code"
    ):
        load_case(folder)
    for name in ("os:system", "antigravity:geohash", "../sealed_joints:tilted", "sealed_joints:"):
        path = changed(folder, "other.toml", ("sealed_joints:plates", name))
        with pytest.raises(InputError, match="expected|--allow-code"):
            load_case(path)


def test_what_one_case_may_run_another_may_not(folder):
    load_case(folder, allow_code=True)
    with pytest.raises(InputError, match="only with --allow-code"):
        load_case(folder)
    text = changed(folder, "words.toml", ("size = 0.02", 'size = "/etc/passwd"'))
    with pytest.raises(InputError, match="mesh.arguments.size"):
        load_case(text, allow_code=True)


def test_an_own_law_is_the_suite_s_where_both_say_the_same(folder):
    springs = elastic(changed(folder, "springs.toml", (OWN, SPRINGS)))
    assert elastic(folder, tilt=0.0) == pytest.approx(springs, rel=1e-9)
    assert np.abs(elastic(folder, tilt=0.5) / springs - 1).max() > 1e-3
    for old, new, words in (
        ("tilt = 0.1", "lean = 0.1", "values.lean: unknown, expected k_n, k_t, tilt"),
        (", tilt = 0.1", "", "values.tilt is missing"),
        ('"1e12 Pa/m"', '"1e12 Pa"', "values.k_n"),
        (":tilted", ":plates", "is function, expected a law"),
        (":tilted", ":titled", "has no attribute 'titled'"),
    ):
        with pytest.raises(InputError, match=words):
            load_case(changed(folder, "wrong.toml", (old, new)), allow_code=True)
    # Indefinite from tilt^2 k_t > k_n on, as the layer's normal is z.
    assert len(elastic(folder, k_t=1.5e12, tilt=0.8))
    with pytest.raises(InputError, match=r"lap: k_n = 1e\+12, .*tilt = 0.9: expected values for"):
        elastic(folder, k_t=1.5e12, tilt=0.9)


def test_an_installed_package_needs_no_permission(folder, tmp_path_factory, monkeypatch):
    place = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index"]
    command += ["--no-build-isolation", "--target", str(place), str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    (folder / "sealed_joints.py").unlink()
    monkeypatch.syspath_prepend(place)
    named = [("sealed_joints:tilted", "tilted"), ("sealed_joints:plates", "plates")]
    own_code.forbid_code()  # packages are looked up once
    case = load_case(changed(folder, "short.toml", *named))
    assert case.joints["lap"].nominal() == {"k_n": 1e12, "k_t": 4e11, "tilt": 0.1}
    assert "tilted is code from the package sealed-joints" in own_code.used()
    assert elastic(folder, False, k_t=1e11)[0] < elastic(folder, False)[0]


def test_commands_take_own_laws_effects_and_meshes(folder):
    """Updating finds the law's property, a diagnosis names it, another effect of one's own, and a
    nonlinear law of one's own slips."""
    hz = elastic(folder, k_t=4e10)
    head, row = ",".join(f"f{i} [Hz]" for i in range(5)), ",".join(map(repr, hz.tolist()))
    (folder / "f.csv").write_text(f"{head}\n{row}\n", encoding="utf-8")
    more = '[test]\nfrequencies = "f.csv"\nnoise = 0.001\n[update]\nparameters = ["lap.k_t"]\n'
    quick = ("[diagnose]", "[diagnose]\nsamples = 4\nmax_effects = 1")
    path = changed(folder, "tested.toml", quick, more=more)
    run(path, "update", "lap.k_t +400.0 GPa/m +(39.9|40.0)")
    asked = ["--effects", "k_t of lap", "--effects", "sealed_joints:wet"]
    assert "wet plates" in run(path, "diagnose", *asked, r"9\d %\)\. K t of lap")
    (folder / "sealed_joints.py").write_text(blocks()["sealed_joints.py"] + WORN, encoding="utf-8")
    path = changed(folder, "slip.toml", (OWN, SPRINGS), more=SLIP)
    run(path, "harmonic", "1.00 N ")


READER = """
from fenics_joints.measurements import TestData


def lines(path):
    hz = np.array([float(line) for line in path.read_text().split()])
    return TestData([1.0], hz[None], [f"mode {i + 1}" for i in range(len(hz))], noise=0.004)


def nothing(path):
    return None
"""


def test_a_reader_of_one_s_own(folder):
    (folder / "f.dat").write_text("101.5\n200.25\n", encoding="utf-8")
    code = blocks()["sealed_joints.py"]
    (folder / "sealed_joints.py").write_text(f"import numpy as np\n{code}{READER}")
    test = '[test]\nfrequencies = "f.dat"\nreader = "sealed_joints:lines"\n'
    path = changed(folder, "read.toml", more=test)
    found = load_case(path, allow_code=True).measured
    assert found.frequencies_hz.tolist() == [[101.5, 200.25]] and found.noise == pytest.approx(
        0.004
    )
    path = changed(folder, "noisy.toml", more=test + "noise = 0.01\n")
    assert load_case(path, allow_code=True).measured.noise == pytest.approx(0.01)
    with pytest.raises(InputError, match="only with --allow-code"):
        load_case(path)
    for old, new, words in (
        (":lines", ":nothing", "test.reader: sealed_joints:nothing: returned NoneType, expected a"),
        ("f.dat", "case.toml", "could not convert string to float"),
        ("[test]", '[test]\nmodes = ["a"]', "reader: expected frequencies, .* and not .*modes"),
    ):
        path = changed(folder, "wrong.toml", more=test.replace(old, new))
        with pytest.raises(InputError, match=words):
            load_case(path, allow_code=True)


SLIP = """[nonlinear.lap]
law = "sealed_joints:Slider"
values = { stiffness = "100 MPa", strength = "5 kPa" }
[harmonic]
band = ["460 Hz", "480 Hz"]
force = { point = ["0 mm", "40 mm", "8 mm"], direction = [0, 0, 1] }
sensor = { point = ["0 mm", "40 mm", "8 mm"], direction = [0, 0, 1] }
levels = ["1 N"]
damping = 0.002
harmonics = 1
modes = 12
"""


def run(path: Path, command: str, *rest: str) -> str:
    """What a command says, which must hold the last of the words."""
    *options, words = rest
    call = [sys.executable, "-m", "fenics_joints", command, str(path), "--allow-code", *options]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and re.search(words, done.stdout), done.stdout + done.stderr
    return done.stdout
