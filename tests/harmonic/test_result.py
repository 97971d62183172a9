"""Derivatives of responses, through the preload too."""

from dataclasses import replace

import numpy as np
from oscillators import BAND, PUSH, SLIDE, STICK, block, jenkins

from fenics_joints.harmonic import ContinuationSettings, solve_harmonic


def test_prescribed_frequencies_and_derivatives():
    """Points of the branch, from warm starts too; derivatives against solving again."""
    branch = solve_harmonic(jenkins(), "push", PUSH, BAND)
    at = branch.frequencies_hz[[30, 10, 20]]
    found = solve_harmonic(jenkins(), "push", PUSH, at=at)
    assert np.allclose(found.coefficients, branch.coefficients[[30, 10, 20]], atol=1e-7)
    warm = solve_harmonic(jenkins(), "push", PUSH, at=at, initial=found)
    assert warm.iterations.max() == 1
    values, step = {"k": STICK, "s": SLIDE}, 1e-4

    def change(v):
        return jenkins(v["k"], v["s"])

    gradient = found.by_parameters(change, values).amplitude("mass", "acceleration")
    for j, key in enumerate(values):
        models = [change({**values, key: values[key] * (1 + s * step)}) for s in (1, -1)]
        up, down = (
            solve_harmonic(model, "push", PUSH, at=at).amplitude("mass", "acceleration")
            for model in models
        )
        expected = (up - down) / (2 * step * values[key])
        assert np.allclose(gradient[:, j], expected, rtol=2e-3, atol=1e-4 * np.abs(expected).max())


def test_derivatives_go_through_the_preload():
    """The state that friction remembers of it changes with the parameters too."""
    base, load = block(), np.array([-1.0, 0.05, 0.0])
    values, step, at = {"normal": 3.0, "friction": 0.3, "stiffness": 1.0}, 1e-5, [0.2, 0.23, 0.28]

    base.stiffness_at_rest()  # compiles the laws; those changed from them are of the same form

    def change(v):
        law = base.interfaces[0].law.with_values(
            normal_stiffness=v["normal"], friction=v["friction"]
        )
        return replace(base.with_laws(floor=law), K=v["stiffness"] * base.K)

    def solve(v, initial=None):
        exact = ContinuationSettings(tolerance=1e-9)
        return solve_harmonic(
            change(v),
            "x",
            0.3,
            at=at,
            static=load,
            settings=exact,
            harmonics=3,
            samples=64,
            initial=initial,
        )

    found = solve(values)
    gradient = found.by_parameters(change, values).amplitude("x")
    for j, key in enumerate(values):
        up, down = (
            solve({**values, key: values[key] * (1 + s * step)}, found).amplitude() for s in (1, -1)
        )
        assert np.allclose(gradient[:, j], (up - down) / (2 * step * values[key]), rtol=1e-4)
