"""Two bolted plates: the section against the solid, homogeneity, convergence, and the sweep."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.database import (
    BoltedPlates,
    Sample,
    Store,
    bolted_plates_radius,
    grid,
    solve_bolted_plates,
    sweep,
)
from fenics_joints.errors import InputError
from fenics_joints.meshes import bolted_plates
from fenics_joints.preload.threads import thread

COMM = MPI.COMM_WORLD
FORCE = 25e3


@pytest.mark.parallel
@pytest.mark.parametrize("model", ["plates", "washers", "bolt"])
def test_section_agrees_with_solid(model):
    """Radius, mean and peak pressure of the section and of a quarter in 3-D, within 2 %."""
    settings = BoltedPlates(model=model, plate_radius=0.06, size=2e-3)
    dimensions = settings.dimensions(thread("M12"), 0.01)
    solid = bolted_plates(COMM, **dimensions, n_around=32, quarter=True)
    flat = solve_bolted_plates("M12", 0.01, FORCE, settings, comm=COMM)["plates"]
    round_ = solve_bolted_plates("M12", 0.01, FORCE, settings, tagged=solid)["plates"]
    assert flat.normal_force == pytest.approx(FORCE, rel=1e-6)
    assert round_.normal_force == pytest.approx(FORCE / 4, rel=1e-6)
    for measure in (
        lambda c: c.radius(1e6),
        lambda c: c.mean_pressure(1e6),
        lambda c: c.pressure.max(),
    ):
        assert measure(round_) == pytest.approx(measure(flat), rel=0.02)


def test_pressure_is_proportional_to_the_force():
    """Plates without a gap, rigid or soft: p / F is the same, also with friction at washers."""
    for more in ({}, {"penalty": 1e12}, {"model": "washers", "washer_friction": 0.2}):
        settings = BoltedPlates(size=2e-3, **more)
        states = (solve_bolted_plates("M12", 0.02, f, settings) for f in (12.5e3, 62.5e3))
        one, five = (state["plates"].pressure for state in states)
        assert np.allclose(five, 5 * one, rtol=1e-6, atol=1e-6 * five.max())


def test_radius_converges_and_does_not_depend_on_what_it_should_not():
    """Halved cells move the radius less each time; E and friction of equal plates not at all."""
    sample = Sample("M12", 0.012, 62.5e3, 0.02)

    def radius(**settings) -> float:
        return bolted_plates_radius(sample, **{"size": 1e-3} | settings)["radius"]

    found = [radius(size=s) for s in (4e-3, 2e-3, 1e-3, 0.5e-3)]
    steps = np.abs(np.diff(found))
    assert steps[2] < steps[0] / 2
    assert steps[2] < 0.02 * found[3]
    # By symmetry equal plates do not slide on one another; the stiffness only scales motions.
    assert radius(friction=0.5) == pytest.approx(found[2], rel=1e-8)
    assert radius(E=100e9) == pytest.approx(found[2], rel=1e-8)
    # The pressures inside the radius carry the force but for what is beyond it.
    outcome = bolted_plates_radius(sample)
    area = np.pi * (outcome["radius"] ** 2 - (thread("M12").hole_diameter / 2) ** 2)
    assert 0.98 < outcome["pressure"] * area / sample.force <= 1.005


@pytest.mark.parallel
def test_sweep_of_contact_analyses(shared_tmp_path):
    """Rows of the sweep are what a single analysis says; a failed one says why."""
    samples = grid(["M12"], [12.5e3, 62.5e3], [0.01]) + grid(["M12"], [1e6], [0.05])
    settings = {"size": 2e-3, "plate_radius": 0.04}
    if COMM.rank == 0:
        Store(shared_tmp_path / "x.db", create=True).close()
    COMM.Barrier()
    with Store(shared_tmp_path / "x.db") as store:
        done = sweep(samples, bolted_plates_radius, store, COMM, model="plates", settings=settings)
        rows = store.joints()
    assert done.computed == 2
    (message,) = done.failed.values()
    assert "rim" in message
    for row in rows:
        sample = Sample(row.bolt, row.diameter, row.force, row.thickness)
        alone = bolted_plates_radius(sample, **settings)
        assert (row.radius, row.pressure) == pytest.approx(tuple(alone.values()), rel=1e-9)
        assert json.loads(row.settings) == settings


@pytest.mark.parametrize(
    "settings, said",
    [
        ({"modell": "bolt"}, "modell"),
        ({"model": "shell"}, "plates, washers, bolt"),
        ({"size": -1}, "size"),
        ({"friction": "rough"}, "friction"),
        ({"penalty": 1e12, "model": "bolt"}, "penalty"),
        ({"P_lim": 1e12}, "nowhere"),
    ],
)
def test_bad_settings_are_named(settings, said):
    with pytest.raises(InputError, match=said):
        bolted_plates_radius(Sample("M12", 0.012, 25e3, 0.02), **{"size": 4e-3} | settings)


@pytest.mark.slow
@pytest.mark.skipif(COMM.size > 1, reason="starts a process itself")
def test_what_the_published_table_lacks(tmp_path):
    """The inquiry: soft contact explains it, and nothing without it comes near."""
    script = Path(__file__).resolve().parents[2] / "demos" / "bolted_plates" / "investigate.py"
    command = [sys.executable, str(script), str(tmp_path / "t.npz"), str(tmp_path / "r.json")]
    subprocess.run(command, check=True, timeout=7200)
    result = json.loads((tmp_path / "r.json").read_text())
    for weighed in result.values():
        soft = [w["log_evidence"] for w in weighed if "soft contact" in w["facts"]]
        others = [w["log_evidence"] for w in weighed if "soft contact" not in w["facts"]]
        assert max(soft) > max(others) + np.log(100)
    alone = next(w for w in result["radii alone"] if w["facts"] == "soft contact")
    assert alone["rms"][0] < 0.045 and max(alone["held_out"].values()) < 0.045
