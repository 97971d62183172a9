"""Time integration against closed forms, other integrators, and energy."""

import numpy as np
import pytest
from mass_chain import chain
from mpi4py import MPI
from oscillators import Jenkins, oscillator
from shooting import slider_motion

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.harmonic import solve_backbone
from fenics_joints.interfaces import InterfaceModel
from fenics_joints.joint_laws import Iwan, Segalman
from fenics_joints.transient import solve_transient, steady_harmonics, stepped_sine

#: Of the end of the chain, so that its joints slip.
SWAY = {"end": lambda t: 0.2 * np.sin(0.3 * t)}


def linear(c=0.02):
    one = np.ones((1, 1))
    return InterfaceModel(one, one, (), c * one, {"push": one[0]}, {"mass": one[0]})


@pytest.mark.smoke
def test_free_decay_converges_with_second_order():
    errors, other = [], []
    for step in (0.1, 0.05, 0.025):
        n_steps = round(20 / step)
        run = solve_transient(linear(), step=step, n_steps=n_steps, initial=([1.0], None, None))
        t, w = run.times, np.sqrt(1 - 1e-4)
        exact = np.exp(-0.01 * t) * (np.cos(w * t) + 0.01 / w * np.sin(w * t))
        errors.append(np.abs(run.displacements["mass"] - exact).max())
        by_force = -run.displacements["mass"] - 0.02 * run.velocities["mass"]
        other.append(np.abs(run.accelerations["mass"] - by_force).max())
    assert np.diff(np.log2(errors)) == pytest.approx([-2, -2], abs=0.1)
    # The method's acceleration is that of a time (1 - r) / (1 + r) steps away, r = 0.9.
    assert other == pytest.approx(np.array([0.1, 0.05, 0.025]) * 0.1 / 1.9, rel=0.05)


def test_ring_down_of_a_linear_oscillator_has_its_frequency_and_damping():
    run = solve_transient(linear(), step=0.02, n_steps=3000, initial=([1.0], None, None))
    decay = run.ring_down("mass")
    assert decay.frequencies_hz * 2 * np.pi == pytest.approx(np.sqrt(1 - 1e-4), rel=1e-4)
    assert decay.damping == pytest.approx(0.01, rel=1e-3)


def test_ring_down_of_a_slipping_joint_follows_the_nonlinear_mode():
    """Frequency and damping over amplitude: by decay, and by the mode of harmonic balance.

    With forty sliders both are smooth; each cycle of the decay has a range of amplitudes.
    """
    law = Iwan(Segalman(1.0, 1.0, -0.5, 0.5), 40, amplitudes=(0.02, 1.4))
    model = oscillator(law, 0.002)
    run = solve_transient(model, step=0.04, n_steps=7500, initial=([0.7], None, None))
    decay = run.ring_down("mass")
    mode = solve_backbone(model, (0.05, 0.7), harmonics=3, samples=256)
    size = np.log(mode.amplitude("mass"))
    inside = (decay.amplitudes > 0.06) & (decay.amplitudes < 0.6)
    at = np.log(decay.amplitudes[inside])
    frequency = np.interp(at, size, mode.frequencies_hz)
    damping = np.interp(at, size, mode.damping_ratios)
    assert np.sum(inside) > 10 and damping.max() > 3 * damping.min()
    assert decay.frequencies_hz[inside] == pytest.approx(frequency, rel=5e-3)
    assert decay.damping[inside] == pytest.approx(damping, rel=0.1)
    assert np.mean(decay.damping[inside] / damping) == pytest.approx(1, abs=0.03)


def test_slider_agrees_with_an_integrator_that_stops_at_every_change_of_stick_and_slip():
    def push(t):
        return 0.15 * np.cos(1.3 * t)

    model = oscillator(Jenkins(k=[1.0], s=[0.1]), 0.02)
    run = solve_transient(model, step=0.01, n_steps=4000, loads={"push": push})
    exact = slider_motion(push, run.times, 1.0, 0.1, 0.02)
    assert np.abs(run.displacements["mass"] - exact).max() < 2e-3 * np.abs(exact).max()


def test_work_of_the_load_is_stored_or_dissipated():
    run = solve_transient(chain(), step=0.02, n_steps=2500, loads=SWAY)
    spent = run.energy + run.damped + run.joint_work["joint"]
    assert np.abs(spent - run.work).max() < 1e-3 * run.work.max()
    assert run.joint_work["joint"][-1] > 0.1 * run.work[-1]


@pytest.mark.parallel
def test_full_model_on_any_number_of_ranks_is_the_dense_one():
    runs = [
        solve_transient(model, step=0.1, n_steps=100, loads=SWAY)
        for model in (chain(), chain(MPI.COMM_WORLD))
    ]
    for key in ("displacements", "accelerations"):
        dense, shared = (getattr(run, key)["end"] for run in runs)
        assert shared == pytest.approx(dense, abs=1e-9 * np.abs(dense).max())
    assert runs[1].joint_work["joint"] == pytest.approx(runs[0].joint_work["joint"], abs=1e-10)
    assert runs[1].energy == pytest.approx(runs[0].energy, abs=1e-10)


def test_a_run_goes_on_from_where_another_ended():
    whole = solve_transient(chain(), step=0.05, n_steps=600, loads=SWAY)
    first = solve_transient(chain(), step=0.05, n_steps=300, loads=SWAY)
    rest = solve_transient(
        chain(), step=0.05, n_steps=300, loads=SWAY, initial=first.final, start=15.0
    )
    # The method starts anew with its own acceleration: the same to its order.
    scale = np.abs(whole.displacements["end"]).max()
    assert rest.displacements["end"][-1] == pytest.approx(
        whole.displacements["end"][-1], abs=1e-3 * scale
    )


def test_stepped_sine_of_a_linear_oscillator_is_its_receptance():
    frequencies = np.array([0.13, 0.155, 0.17])
    found, _ = stepped_sine(
        linear(0.2), "push", 2.0, frequencies, sensor="mass", steps_per_period=200, tolerance=1e-5
    )
    w = 2 * np.pi * frequencies
    exact = 2.0 / (1 - w**2 + 0.2j * w)
    assert found[:, 1] - 1j * found[:, 2] == pytest.approx(exact, rel=2e-3)


def test_steady_harmonics_of_a_known_signal():
    t = np.linspace(0, 3, 1201)
    y = 0.3 + 2 * np.cos(2 * np.pi * 2 * t) - 0.5 * np.sin(3 * 2 * np.pi * 2 * t)
    assert steady_harmonics(t, y, 2.0, 3) == pytest.approx([0.3, 2, 0, 0, 0, 0, -0.5], abs=1e-12)


def test_a_step_that_does_not_converge_is_said_with_its_time():
    with pytest.raises(ConvergenceError, match="t = 0"):
        solve_transient(
            chain(),
            step=0.1,
            n_steps=50,
            loads={"end": lambda t: np.sin(t)},
            petsc_options={"snes_max_it": 1, "snes_rtol": 1e-30, "snes_stol": 0, "snes_atol": 0},
        )
    with pytest.raises(InputError, match="no 'tip'"):
        solve_transient(linear(), step=0.1, n_steps=1, sensors=["tip"])
