"""Effects at a place that is a parameter, of plates' shapes and of supports.

On tests that were made by meshes and matrices that have them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from virtual_strip import (
    SENSORS,
    SIZE,
    held_by,
    measured,
    on_springs,
    strip,
    with_resonator,
    write_strip,
)

from fenics_joints.case import load_case
from fenics_joints.diagnosis.model.prepared import prepare
from fenics_joints.diagnosis.model.subject import subject_of, with_places
from fenics_joints.diagnosis.search import Search
from fenics_joints.diagnosis.zones.sites import COUNT, placed, without_attached
from fenics_joints.errors import InputError
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress

QUIET = Progress(silent=True)
LISTED = (
    "modulus error",
    "density error",
    "local loss of stiffness",
    "local gain of stiffness",
    "added mass",
    "cable or stinger",
    "attached resonator",
    "plate not flat",
    "thickness not even",
)


def bowed(x):
    x[:, 2] += 0.6e-3 * (1 - (2 * x[:, 1] / SIZE[1] - 1) ** 2)
    return x


def tapered(x):
    x[:, 2] += 0.1 * (2 * x[:, 0] / SIZE[0] - 1) * (x[:, 2] - SIZE[2] / 2)
    return x


def ranked(folder, data, listed=LISTED, **more):
    """What is asked of a case, and its fits, the most probable first, with probabilities."""
    effects = ", ".join(f'"{name}"' for name in listed)
    path = write_strip(folder, *data, f"effects = [{effects}]", **more)
    model = prepare(load_case(path), MPI.COMM_SELF, QUIET)
    model.reduce(QUIET)
    model.find_sites()
    search = Search(model, QUIET)
    fits = search.run()
    order, probability = search.ranked(fits)
    return model, [fits[i] for i in order], probability


def leading(fits, probability):
    """Name of the most probable hypothesis, its probability, and its effects' parameters."""
    first = fits[0].hypothesis.table(fits[0].z, fits[0].covariance)
    rows = {row["name"]: row for row in first if not row["nuisance"]}
    return fits[0].hypothesis.label, probability[0], rows


#: What is put in, what it is called, its parameters, each within a factor, and its place, mm.
TRUTHS = {
    "a soft band": (
        lambda: measured(strip(soft=(0.119, 0.161, 0.5))),
        "local loss of stiffness",
        {"depth": (0.5, 1.5), "size": (4.0, 1.5)},
        (140, 30, 3),
    ),
    "a mass": (
        lambda: held_by(0.010, 0.0, (0.22, 0.045, 0.0)),
        "added mass",
        {"mass": (0.010, 1.1)},
        (220, 45, 0),
    ),
    "a hard spot": (
        lambda: measured(strip(soft=(0.119, 0.161, 2.5))),
        "local gain of stiffness",
        {"gain": (1.5, 2.0)},
        (140, 30, 3),
    ),
    # What is mostly a mass is a resonator far below its own frequency, in other words.
    "a lead": (
        lambda: held_by(0.010, 1e4, (0.32, 0.06, 0.0)),
        "cable or stinger, attached resonator",
        {"mass": (0.010, 1.3)},
        (320, 60, 0),
    ),
    "a stinger": (
        lambda: held_by(0.005, 1e5, (0.32, 0.06, 0.0), [(0, 0, 1)]),
        "cable or stinger",
        {"mass": (0.005, 1.3), "stiffness along z": (1e5, 1.3)},
        None,
    ),
    "a harness": (
        lambda: with_resonator(0.008, 370.0, (0.08, 0.0, 0.0)),
        "attached resonator",
        {"mass": (0.008, 2.0), "frequency": (370.0, 1.3)},
        (80, 0, 0),
    ),
    "a harness in the band": (
        lambda: with_resonator(0.008, 380.0, (0.08, 0.0, 0.0), own_share=0.98),
        "attached resonator",
        {"mass": (0.008, 1.5), "frequency": (380.0, 1.05)},
        (80, 0, 0),
    ),
    "a bow": (
        lambda: measured(strip(bowed, thick=0.002)),
        "plate not flat",
        {"height": (0.6e-3, 1.3)},
        None,
    ),
    "a wedge": (
        lambda: measured(strip(tapered)),
        "thickness not even",
        {"taper": (0.1, 1.2)},
        None,
    ),
}


def assert_near(rows, place, most: float) -> None:
    """The place that is found, mm, is no farther than this from the true one."""
    found = [float(c) for c in rows["place"]["at"].split(")")[0][1:].split(",")]
    assert np.linalg.norm(np.subtract(found, place)) < most


@pytest.mark.slow
@pytest.mark.parametrize("truth", TRUTHS)
def test_what_is_there_is_named_first(truth, tmp_path):
    make, names, expected, place = TRUTHS[truth]
    _, fits, probability = ranked(tmp_path, make(), thick=0.002 if truth == "a bow" else SIZE[2])
    label, p, rows = leading(fits, probability)
    assert label in names.split(", ") and p > 0.5
    for key, (value, factor) in expected.items():
        assert value / factor < rows[key]["value"] < value * factor, key
    if place:
        assert_near(rows, place, 35)
    if truth == "a stinger":  # of the other ways it hardly knows more than before
        assert rows["stiffness along x"]["low"] < 3e4


@pytest.mark.slow
def test_what_is_not_there_is_not_named(tmp_path):
    """And a model of one part without joints can be diagnosed."""
    _, fits, probability = ranked(tmp_path, measured(strip()))
    assert fits[0].hypothesis.label == "no gap"
    named = [
        p
        for f, p in zip(fits, probability, strict=True)
        if {e.name for e in f.hypothesis.effects} & set(LISTED[2:])
    ]
    assert sum(named) < 0.15


def test_supports_that_dissipate_are_named(tmp_path):
    """They give way and damp; with the ratios of a plate that damps by itself, they do not."""
    listed = ("modulus error", "end compliance", "damping of the supports")
    hz, shapes, ratios = on_springs(2e11, 0.3)
    _, fits, probability = ranked(tmp_path, (hz, shapes), listed, ratios=ratios)
    label, p, rows = leading(fits, probability)
    assert label == "damping of the supports" and p > 0.5
    assert 0.15 < rows["eta"]["value"] < 0.6
    other = tmp_path / "other"
    other.mkdir()
    _, fits, probability = ranked(other, (hz, shapes), listed, ratios=np.full(len(hz), 1e-3))
    assert leading(fits, probability)[0] == "end compliance"


def test_what_hangs_on_a_spring_has_motions_of_its_own(tmp_path):
    """Frequencies, shapes, and which modes the sensors see, in the band of the test, are those of
    the plate's own modes joined to a mass on springs; the full model has nothing of it."""
    kg, own_hz, at = 0.008, 380.0, (0.075, 0.0, 0.0)
    hz, shapes = with_resonator(kg, own_hz, at, own_share=0.98)
    path = write_strip(tmp_path, hz, shapes, 'effects = ["attached resonator"]')
    model = prepare(load_case(path), MPI.COMM_SELF, QUIET)
    model.reduce(QUIET)
    model.surrogate.exchange(placed(replace(model.sites, points=np.array([at] * COUNT))))
    hz, shapes = with_resonator(kg, own_hz, at, own_share=0.98, plate=model.full)
    effect, values = model.effects[0], dict(model.baseline)
    here = {"place": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
    effect.apply(values, {"mass": kg, "frequency": own_hz, **here}, 0.0)
    found, _ = model.forward(values)
    assert np.exp(found) == pytest.approx(hz, rel=2e-3)
    seen = model.forward.pairing(values).shapes
    same = np.sum(seen * shapes, axis=0) ** 2
    same /= np.sum(seen**2, axis=0) * np.sum(shapes**2, axis=0)
    assert np.all(same > 0.99)
    # One is about its own frequency, where the plate alone has none.
    assert np.abs(np.log(hz / own_hz)).min() < 0.05
    alone = solve_modes(model.full, n_modes=20).frequencies_hz[6:]
    assert np.abs(np.log(alone / own_hz)).min() > 0.3
    # So has the model of all modes that plans are made with, and sees the further ones.
    bare = without_attached(values, model.baseline)
    wide = model.surrogate.wide([model.baseline])
    modes = solve_modes(wide, values, n_modes=20)
    assert np.abs(modes.frequencies_hz / hz[1] - 1).min() < 2e-3
    assert np.abs(modes.frequencies_hz / hz[-1] - 1).min() < 2e-3
    rows = model.surrogate.point_rows(wide, SENSORS.points[:2])[:, 2]
    assert rows @ modes.shapes == pytest.approx(modes.at(SENSORS)[:2])
    with pytest.raises(InputError, match="nothing attached"):
        model.full.stiffness(values)
    assert bare == model.baseline


def test_what_hangs_anywhere_is_named_with_its_place(tmp_path):
    """Where no sensor is and no vertex."""
    kg, own_hz, at = 0.02, 380.0, (0.2, 0.02, 0.0)
    data = with_resonator(kg, own_hz, at)
    _, fits, probability = ranked(tmp_path, data, ("attached resonator",))
    label, p, rows = leading(fits, probability)
    assert label == "attached resonator" and p > 0.5
    assert_near(rows, 1e3 * np.array(at), 15)


@pytest.mark.parallel
def test_places_are_the_same_on_two_ranks(shared_tmp_path):
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        write_strip(shared_tmp_path, np.array([100.0]), np.ones((12, 1)), "rare = true")
    comm.barrier()
    case = load_case(shared_tmp_path)
    alone, together = (
        with_places(subject_of(case.diagnosed(), c, QUIET), case.diagnosed_test().sensors)
        for c in (MPI.COMM_SELF, comm)
    )
    assert together.sites.points == pytest.approx(alone.sites.points)
    assert together.sites.patches == pytest.approx(alone.sites.patches)
    assert together.sites.tapered == alone.sites.tapered and len(alone.sites.bowed) == 2
    given = [
        {"local_loss.depth": 0.5, "local_loss.place": 7.3, "local_loss.size": 2.0},
        {"local_loss.depth": -0.5, "local_loss.place": 7.3, "local_loss.size": 2.0},
        {"taper.block": 0.1},
        {"bow.across": 1e-3},
    ]
    for values in given:
        a, b = (
            solve_modes(s.full, values, n_modes=9).frequencies_hz[7:] for s in (alone, together)
        )
        assert b == pytest.approx(a, rel=1e-6)
