"""Lap plates and a few effects, with a test of frequencies and of a quantity at one point."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse.linalg
from case_tables import write_frequencies
from mpi4py import MPI
from virtual_plates import LAP, E, noisy, plates

from fenics_joints.case import Case, build_structure, load_case
from fenics_joints.diagnosis import Diagnosis, diagnose
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.model.at_points import measured_at_points
from fenics_joints.diagnosis.model.prepared import Prepared, prepare
from fenics_joints.diagnosis.plan.planned import plan
from fenics_joints.measurements import pair_modes
from fenics_joints.modal import Modes, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.structure import Sensors, Structure

NOISE = 1e-3
#: Sensors along the middle of both plates from end to end, and a test by them.
ALONG = Sensors(
    [
        [x, 0.04, 0.0 if x == 0.01 else 0.008 if x < 0.12 else 0.0165]
        for x in (0.01, 0.06, 0.11, 0.16, 0.21, 0.26, 0.31)
    ],
    [0, 0, 1],
)
TEST = """
[test]
frequencies = "frequencies.csv"
noise = "0.1 %"

[test.sees]
along = "x"
positions = ["10 mm", "60 mm", "110 mm", "160 mm", "210 mm", "260 mm", "310 mm"]
at = { y = "40 mm", z = ["0 mm", "8 mm", "8 mm", "16.5 mm", "16.5 mm", "16.5 mm", "16.5 mm"] }
direction = [0, 0, 1]
"""

_DIAGNOSE = """
[diagnose]
n_modes = {n_modes}
samples = 8
discrepancy = "0.3 %"
max_effects = 1
patches = 0
effects = {effects}
"""


@dataclass(frozen=True)
class Plates:
    """Lap plates of which some effects are weighed.

    Attributes:
        effects: Their names.
        n_modes: Number of modes of each model.
        tolerance: Of modulus and density, %.
        more: What else the case says.
    """

    effects: tuple[str, ...]
    n_modes: int
    tolerance: float
    more: str = ""

    def written(self, folder: Path, test: str = "", E: float = E, size=20) -> Case:
        """The case with this test, in a folder; elements of ``size`` mm."""
        within = f'tolerance = {{ E = "{self.tolerance} %", rho = "{self.tolerance} %" }}\n'
        text = plates(LAP + "bolted = true\n", within, size=size, E=E, G=E / 2.566)
        text += _DIAGNOSE.format(n_modes=self.n_modes, effects=json.dumps(self.effects))
        folder.mkdir(exist_ok=True)
        (folder / "case.toml").write_text(text + self.more + test, encoding="utf-8")
        return load_case(folder)

    def true(
        self, folder: Path, n_modes: int, E: float = E, **own: float
    ) -> tuple[Structure, dict[str, float], Modes, np.ndarray]:
        """Bonded plates on another mesh: structure, values, modes, and measured frequencies, Hz."""
        case = self.written(folder, E=E, size=16)
        full = build_structure(case, MPI.COMM_SELF, law="uncoupled", attached=True)
        values = {"lap.E": 3e11, "lap.G": 1e11, **own}
        modes = solve_modes(full, values, n_modes=n_modes)
        return full, values, modes, modes.frequencies_hz[pair_modes(modes, 4, ALONG).index]

    def tested(self, folder: Path, hz: np.ndarray, more: str = "") -> Case:
        """The case with a test of frequencies, with noise, and of what ``more`` says."""
        folder.mkdir(exist_ok=True)
        write_frequencies(folder, noisy(hz, NOISE, np.random.default_rng(2)))
        return self.written(folder, TEST + more)

    def gains(self, folder: Path, keep: Path) -> dict[str, float]:
        """What each further measurement would gain beside a planned test of frequencies."""
        listed = TEST.replace('frequencies = "frequencies.csv"\n', "")
        case = self.written(folder, listed + "[test.planned]\nmodes = 4\n")
        found = plan(case, MPI.COMM_SELF, keep=keep)
        return {each.measurement: each.mean_gain for each in found.additions}


def said(case: Case, keep: Path) -> dict[str, float]:
    """Probability of each effect."""
    result: Diagnosis = diagnose(case, MPI.COMM_SELF, keep=keep)
    return {e.name: e.probability for e in result.effects}


def reduced(case: Case, keep: Path | None = None) -> Prepared:
    """A case ready to be diagnosed, with its reduced model and what a patch would do."""
    model = prepare(case, MPI.COMM_SELF, Progress(silent=True))
    model.reduce(Progress(silent=True), keep)
    model.place_unknown()
    return model


def measure_again(model: Prepared, table: str, name: str, **changes) -> None:
    """Take single numbers of a test once more, of a section that is changed."""
    case, section = model.case, getattr(model.case.test, table)[name]
    sections = {name: section.model_copy(update=changes)}
    test = case.test.model_copy(update={table: sections})
    changed = replace(model, case=case.model_copy(update={"test": test}))
    measured_at_points(changed, Progress(silent=True))


def sparse(A) -> scipy.sparse.csc_matrix:
    """A matrix of one rank, to be factorised by SciPy."""
    rows, columns, values = A.getValuesCSR()
    return scipy.sparse.csr_matrix((values, columns, rows), shape=A.getSize()).tocsc()


def solved(A: scipy.sparse.csc_matrix, b: np.ndarray) -> np.ndarray:
    """A^-1 b of a symmetric matrix, by a factorisation that is not PETSc's."""
    return scipy.sparse.linalg.spsolve(A, b, permc_spec="MMD_AT_PLUS_A")


def check_derivatives(model, hypothesis, own: np.ndarray, j: int, floor: float = 1e-9) -> None:
    """Compare derivatives of some predicted entries with differences along parameter ``j``, and
    predictions of one point with those of a batch."""
    z = 0.3 * np.random.default_rng(1).standard_normal((3, len(hypothesis.priors)))
    many = ManyPredictions(hypothesis, model.forward, model.evidence, model.baseline)
    found, by_z = zip(*map(many.at, z), strict=True)
    step = 1e-3 * np.eye(len(z[0]))[j]
    differences = (many.at(z[0] + step)[0] - many.at(z[0] - step)[0])[own] / 2e-3
    assert by_z[0][own, j] == pytest.approx(differences, rel=1e-4, abs=floor)
    together, along = many(z, range(len(z[0])))
    assert together[:, own] == pytest.approx(np.array(found)[:, own], rel=1e-9, abs=floor)
    assert along[:, own] == pytest.approx(np.array(by_z)[:, own], abs=floor)
