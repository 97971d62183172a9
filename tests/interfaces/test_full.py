"""Time integration of a full finite-element model against harmonic balance of the reduced one.

The section of the lap beam, coarse, with its paper's joint law, about its first resonance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from eigen_slopes import assert_same
from mpi4py import MPI

from fenics_joints.harmonic import solve_harmonic, solve_static_backbone
from fenics_joints.interfaces import (
    FullModel,
    InterfaceModel,
    full_layers,
    loading_shapes,
    reduce_layers,
)
from fenics_joints.joint_laws import Iwan, IwanLayer, RichardAbbott
from fenics_joints.meshes import lap_beam_section
from fenics_joints.modal import Modes, solve_modes
from fenics_joints.structure import Structure, Support, interface, joint, part
from fenics_joints.structure.sparse import absolute, as_columns, product
from fenics_joints.transient import solve_transient, steady_harmonics, stepped_sine

#: Of the meshed layer, a hundredth of the paper's, Pa.
E, G, RATIO = 6.5472e6, 1.6813e6, 100.0
#: Over a width of 1 m, N: it takes a seventh off the peak of the linear response.
FORCE, DAMPING = 1800.0, 0.03
PLACES = {
    "forces": {"push": ((0.1, -6.03e-3), (0, 1))},
    "sensors": {"tip": ((0.42, 6.03e-3), (0, 1))},
}
#: A stiff layer leaves little of the residual to Newton's method.
OPTIONS = {"snes_rtol": 1e-6}


def law(n_sliders: int = 6) -> IwanLayer:
    backbone = RichardAbbott(RATIO * E, 101e3, 574.26e3, 2.5)
    return IwanLayer(backbone, RATIO * G, n_sliders, thickness=RATIO)


@dataclass(frozen=True)
class Beam:
    """The structure, its modes, its full model, and reduced ones; damping in proportion to mass."""

    structure: Structure
    modes: Modes
    full: FullModel

    @property
    def rate(self) -> float:
        """Damping over mass, 1/s."""
        return 2 * DAMPING * float(np.sqrt(self.modes.eigenvalues[0]))

    def reduced(self, n_modes: int = 6, n_shapes: int = 12, **options) -> InterfaceModel:
        shapes = self.shapes(n_shapes) if n_shapes else []
        options = {"n_modes": n_modes, "extra": shapes, "interface_modes": 0} | PLACES | options
        model = reduce_layers(self.structure, {"lap": law()}, **options)
        return InterfaceModel(
            model.M, model.K, model.interfaces, self.rate * model.M, model.forces, model.sensors
        )

    def shapes(self, n: int) -> list:
        """As the first mode's inertia loads it up to what a linear joint would do at resonance."""
        shape = self.modes.shapes[0]
        load = self.full.M.createVecLeft()
        self.full.M.mult(shape, load)
        load.scale(abs(self.full.forces["push"].dot(shape)) * FORCE / (2 * DAMPING))
        return loading_shapes(self.full, load, np.geomspace(0.01, 1.0, n))


def make_beam(comm: MPI.Comm) -> Beam:
    mesh = lap_beam_section(comm, n_length=3, n_lap=3, layer=6e-5, washer=0.0)
    beams = part("beams", ("beam_1", "beam_2"), E=207e9, nu=0.3, rho=7800.0)
    layer = joint("lap", ("joint",), E=E, G=G, normal=(0.0, 1.0))
    structure = Structure(mesh, [beams, layer], [], degree=2, supports=[Support("clamp")])
    modes = solve_modes(structure, n_modes=6)
    full = full_layers(structure, {"lap": law()}, **PLACES)
    damping = full.M.copy()
    damping.scale(2 * DAMPING * float(np.sqrt(modes.eigenvalues[0])))
    return Beam(structure, modes, replace(full, C=damping))


@pytest.fixture(scope="module")
def beam() -> Beam:
    return make_beam(MPI.COMM_SELF)


@pytest.mark.parametrize("coupled", [True, False])
def test_springs_per_area_are_the_layer_of_that_stiffness(beam, coupled):
    """In the full model and in the reduced one, with a law that takes all stress or the shear."""
    backbone = RichardAbbott(RATIO * G, 0.0, 1e5, 2.5)
    nonlinear = law() if coupled else Iwan(backbone, 6, thickness=RATIO)
    h, there = 6e-5, beam.structure
    springs = interface("lap", ("joint",), k_n=E / h, k_t=G / h, meshed=h, normal=(0.0, 1.0))
    same = Structure(
        there.tagged, [there.regions[0], springs], [], degree=2, supports=[Support("clamp")]
    )
    a, b = (full_layers(s, {"lap": nonlinear}) for s in (there, same))
    assert_same(a.K, b.K, 1e-12)
    assert_same(a.M, b.M, 1e-12)
    kept = [reduce_layers(s, {"lap": nonlinear}, n_modes=4) for s in (there, same)]
    hz = [solve_modes(model, n_modes=4).frequencies_hz for model in kept]
    # Entries of K are far above its lowest eigenvalue, so that half a digit of theirs shows in it.
    K, shapes = absolute(there.stiffness()), as_columns(beam.modes.shapes[:4])
    terms = np.sum(abs(shapes) * product(K, abs(shapes)), axis=0)
    round_off = 0.25 * np.finfo(float).eps * terms / beam.modes.eigenvalues[:4]
    assert round_off[0] < 1e-7 and np.all(round_off[1:] < 1e-8)
    assert np.all(abs(hz[1] / hz[0] - 1) <= np.maximum(1e-8, round_off))
    assert hz[1] == pytest.approx(beam.modes.frequencies_hz[:4], rel=1e-4)


@pytest.fixture(scope="module")
def reduced(beam) -> InterfaceModel:
    return beam.reduced()


def response(model: InterfaceModel, at, **options) -> np.ndarray:
    """First harmonic at the tip, complex, m."""
    found = solve_harmonic(model, "push", FORCE, at=at, **options)
    c = found.sensor_coefficients("tip")
    return c[:, 1] - 1j * c[:, 2]


def linear_response(model: InterfaceModel, hertz: float) -> complex:
    w = 2 * np.pi * hertz
    A = model.stiffness_at_rest() - w**2 * model.M + 1j * w * model.C
    return FORCE * model.sensors["tip"] @ np.linalg.solve(A, model.forces["push"])


def near_resonance(beam: Beam) -> np.ndarray:
    """Frequencies on both sides of the nonlinear resonance, Hz."""
    return float(beam.modes.frequencies_hz[0]) * np.array([0.96, 0.98, 0.99, 1.0, 1.03])


def errors(values, exact) -> np.ndarray:
    """Largest differences relative to the largest exact response, for each of ``values``."""
    return np.array([np.abs(v - exact).max() for v in values]) / np.abs(exact).max()


def start(beam: Beam, value: complex, hertz: float) -> tuple:
    """The first mode, moving so that the tip has a response; what is wrong with it dies out."""
    shape = beam.modes.shapes[0]
    tip = beam.full.sensors["tip"].dot(shape)
    u, v = shape.copy(), shape.copy()
    u.scale(value.real / tip)
    v.scale(-value.imag * 2 * np.pi * hertz / tip)
    return u, v, None


# -- two ways to one response ----------------------------------------------------------------------


def stepped(beam: Beam, hertz: float, steps: int, tolerance: float, **options) -> np.ndarray:
    """Harmonics at the tip by time integration of the full model."""
    options |= {"sensor": "tip", "steps_per_period": steps, "tolerance": tolerance}
    return stepped_sine(beam.full, "push", FORCE, [hertz], petsc_options=OPTIONS, **options)[0]


def test_full_model_in_time_is_the_reduced_one_in_harmonics(beam, reduced):
    """At the peak: amplitude and phase, where the response is a seventh off the linear one."""
    f1 = float(beam.modes.frequencies_hz[0])
    peak = solve_harmonic(reduced, "push", FORCE, (0.97 * f1, 1.01 * f1)).peak
    (balance,) = response(reduced, [peak.frequency_hz], harmonics=15, samples=256)
    assert abs(balance) < 0.87 * abs(linear_response(reduced, f1))
    assert abs(balance - linear_response(reduced, peak.frequency_hz)) > 0.1 * abs(balance)
    near = start(beam, 1.01 * balance, peak.frequency_hz)
    c = stepped(beam, peak.frequency_hz, 80, 2e-3, initial=near, harmonics=3)
    time = c[0, 1] - 1j * c[0, 2]
    assert abs(time) == pytest.approx(abs(balance), rel=3e-3)
    # The integrator's period is longer by (omega step)^2 / 12 of it: 0.016 rad of phase.
    assert np.angle(time / balance) == pytest.approx(0.0, abs=0.02)


@pytest.mark.slow
def test_full_and_reduced_models_agree_over_the_resonance(beam, reduced):
    """From rest, with finer steps, on both flanks and at the peak; third harmonic too."""
    for hertz in near_resonance(beam)[1:4]:
        found = solve_harmonic(reduced, "push", FORCE, at=[hertz], harmonics=15, samples=512)
        exact = found.sensor_coefficients("tip")[0]
        c = stepped(beam, hertz, 300, 5e-4)
        size = np.hypot(*exact[1:3])
        assert np.abs(c[0, 1:3] - exact[1:3]).max() < 5e-3 * size
        assert np.abs(c[0, 5:7] - exact[5:7]).max() < 5e-4 * size


@pytest.mark.parallel
def test_full_model_moves_alike_on_any_number_of_ranks(beam):
    value, hertz = 0.012 - 0.005j, 29.4
    alone, together = (
        solve_transient(
            b.full,
            step=1 / hertz / 50,
            n_steps=60,
            initial=start(b, value, hertz),
            loads={"push": lambda t: FORCE * np.cos(2 * np.pi * hertz * t)},
            petsc_options=OPTIONS,
        )
        for b in (beam, make_beam(MPI.COMM_WORLD))
    )
    for key, name in (("displacements", "tip"), ("joint_work", "lap")):
        exact, found = (getattr(run, key)[name] for run in (alone, together))
        assert found == pytest.approx(exact, abs=1e-5 * np.abs(exact).max())
    # Of an elastic joint all work comes back twice a period.
    work = alone.joint_work["lap"]
    assert work[30:].min() > 0.03 * work.max()


# -- convergence -----------------------------------------------------------------------------------


def falls(found: np.ndarray, last: float) -> None:
    """Errors fall from one to the next, to at most ``last``."""
    assert np.all(np.diff(found) < 0), found
    assert found[-1] < last, found


def test_converges_with_harmonics(beam, reduced):
    at = near_resonance(beam)
    runs = [response(reduced, at, harmonics=H, samples=256) for H in (1, 3, 5, 7, 15)]
    falls(errors(runs[:-1], runs[-1]), 3e-3)


def test_converges_with_samples(beam, reduced):
    at = near_resonance(beam)
    runs = [response(reduced, at, samples=T) for T in (16, 32, 64, 128, 1024)]
    falls(errors(runs[:-1], runs[-1]), 1e-3)


def test_converges_with_sliders(beam, reduced):
    at = near_resonance(beam)
    runs = [response(reduced.with_laws(lap=law(n)), at) for n in (4, 8, 16, 32, 128)]
    found = errors(runs[:-1], runs[-1])
    assert found[0] < 5e-3  # four happen to be better than eight here
    falls(found[1:], 3e-4)


def test_converges_with_shapes_and_interface_modes(beam):
    """Two ways to a basis that knows how the joint gives way; the modes alone do not."""
    at = near_resonance(beam)
    exact = response(beam.reduced(20, 24, interface_modes=16), at)
    by_shapes = errors([response(beam.reduced(6, n), at) for n in (0, 2, 6)], exact)
    by_modes = errors(
        [response(beam.reduced(6, 0, interface_modes=n), at) for n in (0, 4, 8, 16)], exact
    )
    assert by_shapes[0] > 0.05
    falls(by_shapes, 1e-3)
    falls(by_modes, 1e-3)


def test_time_integration_converges_to_harmonic_balance(beam, reduced):
    """Of the reduced model: errors fall fourfold with half the step."""
    (hertz,) = near_resonance(beam)[1:2]
    found = solve_harmonic(reduced, "push", FORCE, at=[hertz], harmonics=9, samples=512)
    exact = found.sensor_coefficients("tip")[0, 1] - 1j * found.sensor_coefficients("tip")[0, 2]
    runs = []
    for steps in (50, 100):
        run = solve_transient(
            reduced,
            step=1 / hertz / steps,
            n_steps=45 * steps,
            sensors=["tip"],
            loads={"push": lambda t: FORCE * np.cos(2 * np.pi * hertz * t)},
        )
        c = steady_harmonics(run.times, run.displacements["tip"], hertz)
        runs.append(c[1] - 1j * c[2])
    coarse, fine = errors(runs, exact)
    assert coarse / fine == pytest.approx(4.0, rel=0.25)
    assert fine < 0.015


def test_static_backbones_of_the_full_and_the_reduced_beam_agree(beam, reduced):
    """By the same static loads, where the joint has begun to yield."""
    span = (1e-3, 3e-2)
    full = solve_static_backbone(beam.full, span, per_decade=6)
    small = solve_static_backbone(reduced, span, per_decade=6)
    assert full.frequencies_hz[0] == pytest.approx(beam.modes.frequencies_hz[0], rel=1e-3)
    assert full.damping_ratios[-1] > 1.1 * full.damping_ratios[0]
    assert np.allclose(small.frequencies_hz, full.frequencies_hz, rtol=1e-3)
    assert np.allclose(small.damping_ratios, full.damping_ratios, rtol=0.02)
