"""The world of the blind check: independent of the package, and true to its own physics."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dolfinx")
pytest.importorskip("gmsh")

from benchmarks.blind import discrepancy, world
from benchmarks.blind.reckoning import sheets_of
from benchmarks.blind.world import draw
from benchmarks.blind.world.eigen import lowest_modes
from benchmarks.blind.world.levels import gapping, slip

# Names of the sealed generator stand as they were sealed.
from benchmarks.blind.world.model import _nominal as nominal_specimen
from benchmarks.blind.world.model import _Small as Small
from benchmarks.blind.world.model import _Specimen as Specimen
from benchmarks.blind.world.model import calibrate_levels
from benchmarks.blind.world.pressure import pressures
from benchmarks.blind.world.rigs import RIGS
from benchmarks.blind.world.whole import BONDED, Build, Whole
from fenics_joints.case import load_case

WORLD = Path(world.__file__).parent
BLIND = ("lap_plates", "c_beam", "lap_beam")


@pytest.mark.parametrize("geometry", BLIND)
def test_the_oracle_knows_all_sizes_that_are_drawn(geometry):
    """Sizes that the generator draws against the ranges by which D is computed."""
    random, found = np.random.default_rng(0), {}
    for sheet in sheets_of(geometry):
        ends = [sheet.params(u, sheet.vs[0]) for u in sheet.span]
        key = next(iter(ends[0])) if sheet.name != "normal_and_tangential" else "k_t"
        found.setdefault((sheet.name, key), []).extend(end[key] for end in ends)
    for (name, key), ends in found.items():
        drawn = [draw(random, geometry, name)["params"][key] for _ in range(400)]
        low, high = np.log([min(ends), max(ends)])
        assert np.log(min(drawn)) == pytest.approx(low, abs=0.05 * (high - low)), name
        assert np.log(max(drawn)) == pytest.approx(high, abs=0.05 * (high - low)), name


@pytest.fixture(scope="module")
def lap_beam() -> Whole:
    return Whole(RIGS["lap_beam"])


# -- structure and joint ---------------------------------------------------------------------------


@pytest.mark.parametrize("build", [{}, {"width": [1.1, 0.93], "thickness": [0.9, 1.2]}])
def test_joint_leaves_rigid_motions_free(lap_beam, build):
    """Also where the bodies differ: springs between points that do not meet would hold a turn."""
    build = Build(**build, clamp=1e-6)
    lap_beam.shape(build)
    k, m = lap_beam.matrices(build)
    ones = np.full(len(lap_beam.points), BONDED)
    k = k + lap_beam.interface(build).stiffness(ones, ones)
    x = np.concatenate([body.space.tabulate_dof_coordinates() for body in lap_beam.bodies])
    turns = [np.cross(axis, x).ravel() for axis in np.eye(3)]
    shifts = [np.tile(axis, len(x)) for axis in np.eye(3)]
    for motion in (*shifts, *turns):
        bent = np.abs(k.diagonal()).max() * np.abs(motion).max()
        assert np.abs(k @ motion).max() < 1e-10 * bent
    sizes = zip(build.width, build.thickness, strict=True)
    solid = 7800 * 0.235 * 0.0254 * 0.006 * sum(w * t for w, t in sizes)
    assert shifts[0] @ (m @ shifts[0]) == pytest.approx(solid + 0.008, rel=1e-9)


def test_pressure_balances_the_bolt(lap_beam):
    p = pressures(lap_beam)[0]
    assert p.min() == 0.0
    assert p @ lap_beam._weights == pytest.approx(1.0, rel=1e-3)
    centre = (p * lap_beam._weights) @ lap_beam.points
    # The lap is symmetric about the bolt, its beams' free ends are not.
    assert centre == pytest.approx([0.21, 0.0], abs=3e-4)


def cycle(force, n: int = 20001):
    """First harmonic in phase with the motion, and work, over a cycle of unit amplitude."""
    angle = np.linspace(0, 2 * np.pi, n)
    f, u = force(np.cos(angle), -np.sin(angle)), np.cos(angle)
    return np.trapezoid(f * u, angle) / np.pi, np.trapezoid(f * -np.sin(angle), angle)


@pytest.mark.parametrize("limit", [0.2, 0.7, 1.5])
def test_equivalent_springs_are_the_cycles_first_harmonic(limit):
    def jenkins(u, velocity):
        # Masing: from each turning point the spring unloads until it slides the other way.
        most = min(limit, 1.0)
        back, forth = np.maximum(most - (1 - u), -limit), np.minimum((1 + u) - most, limit)
        return np.where(velocity <= 0, back, forth)

    stiffness, work = cycle(jenkins)
    given, lost = slip(np.ones(1), np.ones(1), np.array([limit]))
    assert given[0] == pytest.approx(stiffness, rel=1e-3)
    assert lost[0] == pytest.approx(work, abs=1e-3)
    stiffness, work = cycle(lambda u, velocity: np.clip(u, -limit, limit))
    assert gapping(np.ones(1), np.ones(1), np.array([limit]))[0] == pytest.approx(stiffness, 1e-3)
    assert work == pytest.approx(0.0, abs=1e-9)


def test_slipping_mode_is_one_of_the_full_structure():
    """The basis of modes against all unknowns, with the joint as slip leaves it."""
    effect = {"name": "micro_slip", "region": "joint", "params": {"mu": 0.3, "drop": 0.01}}
    spec = replace(world.nominal_spec("lap_beam", "level"), effects=[effect])
    top = calibrate_levels(spec, 0.01, (1.0, 2.0))[-1]
    specimen = Specimen(spec)
    small = Small(specimen, *nominal_specimen("lap_beam"))
    small.enrich([small.mode(j, top, 2.5e-3) for j in range(6)])
    for j in (1, 5):
        hz, damping, phi, q = small.mode(j, top, 2.5e-3)
        assert hz < small.rest.hz[j] * 0.997 and damping > 4e-3
        motion = np.hypot(*(row @ phi * q for row in small.rows[:2]))
        k_t, _ = slip(small.k_t, motion, 0.3 * small.p)
        joint = specimen.interface.stiffness(small.k_n, k_t)
        full, _ = lowest_modes(specimen.k + joint, specimen.m, 14, 10.0)
        assert np.abs(full / hz - 1).min() < 1e-4


# -- cases -----------------------------------------------------------------------------------------


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("c_beam", "lap_plates")]


@pytest.mark.parametrize("geometry", ["lap_beam", *SLOW])
def test_nominal_model_is_as_near_as_it_says(geometry):
    model, _, truth, shapes = discrepancy.compare(geometry)
    text = (WORLD.parent / "nominal" / f"{geometry}.toml").read_text(encoding="utf-8")
    line = next(x for x in text.splitlines() if x.startswith("discrepancy"))
    stated = float(line.split('"')[1].removesuffix(" %")) / 100
    error = np.sqrt(np.mean((model / truth - 1) ** 2))
    assert 0.3 * stated < error < 1.05 * stated
    assert np.sqrt(np.mean(shapes**2)) < 0.02


def test_case_shows_the_truth_with_its_noise(tmp_path):
    truth = world.generate("lap_beam", "single", ["modulus"], 11, tmp_path)
    data = load_case(tmp_path).measurements()
    files = {"case.toml", "damping.csv", "frequencies.csv", "shapes.csv"}
    assert {path.name for path in tmp_path.iterdir()} == files
    clean = np.array(truth["frequencies"])
    noise = np.log(data.frequencies_hz / clean) / truth["noise"][0]
    assert 0.5 < np.std(noise) < 1.6 and np.abs(noise).max() < 5
    assert data.noise == pytest.approx(truth["noise"][0])
    again = world.clean(truth["spec"])
    assert again.frequencies == pytest.approx(clean, rel=1e-9)
    # A modulus of one beam: between none and all of the root of its factor, in every mode.
    factor = truth["effects"][0]["params"]["factor"]
    bare = world.clean({**truth["spec"], "effects": []})
    share = np.log(clean / bare.frequencies) / (0.5 * np.log(factor))
    assert share.min() > 0 and share.max() < 1


def test_plan_is_balanced_and_keeps_back_what_is_for_the_final_check():
    for final in (False, True):
        cases = world.plan(200, 3, final)
        kinds = Counter(kind for _, kind, _, _ in cases)
        assert kinds == {"none": 50, "single": 80, "pair": 40, "unknown": 30}
        assert {g for g, _, _, _ in cases} == set(BLIND[: 2 + final])
        named = {e for _, _, effects, _ in cases for e in effects}
        assert named.isdisjoint(world.FINAL_ONLY) or final
        single = Counter(e for _, kind, effects, _ in cases for e in effects if kind == "single")
        assert len(single) >= 13 and max(single.values()) <= 3 * min(single.values()) + 2
    assert world.plan(40, 1, False) == world.plan(40, 1, False) != world.plan(40, 2, False)
