"""Causes that show only between levels of a test: on virtual tests from loops that are integrated.

The data come from another mesh, with the joint in two zones; the motion of each zone follows from
force, damping and shape by a fixed point, and each zone's stiffness and loss from a numerical
hysteresis loop. The diagnosis knows closed forms of one zone only.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from case_tables import write_frequencies
from mpi4py import MPI
from virtual_plates import LAP, LAYER, NU, RHO, SEES, E, along, noisy, plates

from fenics_joints.case import load_case
from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.effects.damping import (
    GROWING,
    NAMES,
    iwan_loss_factor,
    micro_slip,
    relative_drop,
)
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.predictions import (
    ManyPredictions,
    PointwiseForward,
    at_conditions,
    model_of,
)
from fenics_joints.diagnosis.zones.zone import Zone
from fenics_joints.forms import lame_parameters
from fenics_joints.measurements import pair_modes
from fenics_joints.meshes import lap_plates
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.structure import Parameter, Sensors, Structure, joint, part

LEVELS = np.array([1.0, 2.0, 4.0])
NOISE, DAMPING_NOISE = 5e-4, 0.05
#: Tangential stiffness of the joint at rest per area, Pa/m.
STIFFNESS = 3e11
AT_REST = np.array([2e-3, 1.5e-3, 3e-3])
#: Exponent of the sliders' strengths, and shear strain at which the strongest slides.
CHI, SLIDING = -0.4, 0.05

_TEST = """
[test]
frequencies = "frequencies.csv"
{damping}
damping_noise = "5 %"
condition = "level"
noise = "0.05 %"
"""
_DIAGNOSE = """
[diagnose]
n_modes = 16
samples = 8
discrepancy = "0.5 %"
patches = 0
mesh_error = false  # the data are of this mesh
"""
#: The joint as it is at rest, and only what changes with the level; and this beside its compliance.
ALONE = f'joints = "given"\nmax_effects = 1\neffects = {json.dumps(NAMES)}\n'
BESIDE = f"effects = {json.dumps(['joint tangential compliance', *NAMES])}\n"


# -- the virtual test ------------------------------------------------------------------------------


def iwan(amplitude: float, n: int = 1500, steps: int = 240) -> tuple[float, float]:
    """Stiffness over that at rest, and loss factor, from the first harmonic of a loop of sliders.

    Args:
        amplitude: Amplitude over that at which the strongest slider slides.
        n: Number of sliders, of equal stiffness.
        steps: Steps in a cycle.
    """
    strength = ((np.arange(n) + 0.5) / n) ** (1 / (CHI + 1))
    angle = 2 * np.pi * np.arange(2 * steps + 1) / steps
    u = amplitude * np.cos(angle)
    force, forces = np.clip(np.full(n, u[0]), -strength, strength), []
    for du in np.diff(u):
        force = np.clip(force + du, -strength, strength)
        forces.append(force.mean())
    last, angle = np.array(forces[-steps:]), angle[-steps:]
    stiffness = 2 * np.mean(last * np.cos(angle)) / amplitude
    return stiffness, 2 * abs(np.mean(last * np.sin(angle))) / amplitude / stiffness


def elastic(amplitude: float) -> tuple[float, float]:
    """The same of a spring that softens by opening: its loop has no area."""
    u = amplitude * np.cos(2 * np.pi * np.arange(240) / 240)
    force = u / np.sqrt(1 + np.abs(u / 0.6))
    return 2 * np.mean(force * u) / amplitude**2, 0.0


def linear(amplitude: float) -> tuple[float, float]:
    """The same of a joint that stays as it is."""
    return 1.0, 0.0


def at_rest_modulus(stiffness: float) -> float:
    """Shear modulus of the layer with a stiffness per area, Pa/m, in series with it."""
    return 1 / (1 / lame_parameters(E, NU)[1] + 1 / (stiffness * LAYER))


@dataclass(eq=False)
class Rig:
    """The true structure, reduced to its modes over the joint's stiffness.

    Attributes:
        model: Reduced structure with the parameters of `zones`.
        at_rest: Stiffness of each zone at rest.
        volumes: Volume of each zone, m3.
    """

    model: object
    at_rest: dict[str, float]
    volumes: dict[str, float]
    sensors: Sensors

    @classmethod
    def make(cls, stiffness: float) -> Rig:
        """A rig whose joint has this tangential stiffness per area, Pa/m."""
        tagged = lap_plates(MPI.COMM_SELF, element_size=0.016, n_thickness=1, layer=LAYER)
        lmbda, mu = lame_parameters(E, NU)
        g = at_rest_modulus(stiffness)
        metal = part("plates", ("plate_1", "plate_2"), E=E, nu=NU, rho=RHO)
        zones = [
            joint(zone, f"joint_{zone}", E=lmbda + 2 * mu, G=f"G_{zone}")
            for zone in ("near", "away")
        ]
        names = ["G_near", "G_away"]
        full = Structure(tagged, [metal, *zones], [Parameter(name, g) for name in names])
        samples = [{names[0]: a * g, names[1]: b * g} for a, b in ((1, 1), (0.4, 1), (1, 0.4))]
        volumes = dict(zip(names, full.volumes()[1:], strict=True))
        return cls(reduce(full, samples, 16), dict.fromkeys(names, g), volumes, along(LAYER))

    def mode(self, i: int, force: float, law) -> tuple[float, float]:
        """Frequency, Hz, and damping ratio of a mode at resonance under a force on the end."""
        values = dict(self.at_rest)
        loss = dict.fromkeys(values, 0.0)
        column = {name: j for j, name in enumerate(self.model.parameters)}
        for _ in range(60):
            modes = solve_modes(self.model, values, n_modes=16)
            k = pair_modes(modes, len(AT_REST), self.sensors).index[i]
            value = modes.eigenvalues[k]
            strains = dict(zip(column, modes.gradients([k])[0], strict=True))
            shares = {name: values[name] * strains[name] / value for name in values}
            damping = AT_REST[i] + 0.5 * sum(loss[name] * shares[name] for name in values)
            motion = force * abs(modes.at(self.sensors)[0, k]) / (2 * damping * value)
            before = dict(values)
            for name in values:
                amplitude = motion * np.sqrt(strains[name] / self.volumes[name]) / SLIDING
                left, loss[name] = law(amplitude)
                values[name] = 0.5 * (values[name] + left * self.at_rest[name])
            if all(abs(values[name] / before[name] - 1) < 1e-7 for name in values):
                return modes.frequencies_hz[k], damping
        pytest.fail("the fixed point was not found")


@cache
def virtual_levels(rig: Rig, law, n_modes: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and damping ratios of the first modes at all levels, (n, m)."""
    found = [[rig.mode(i, force, law) for i in range(n_modes)] for force in LEVELS]
    return tuple(np.moveaxis(found, -1, 0))


@pytest.fixture(scope="module")
def rig():
    return Rig.make(STIFFNESS)


def write(folder: Path, frequencies, damping, levels, lines: str) -> Path:
    """A case's folder with the data of these levels."""
    bending = "bending", "level [N]", levels
    write_frequencies(folder, frequencies, *bending)
    if damping is not None:
        write_frequencies(folder, damping, *bending, "damping.csv", "")
    line = "" if damping is None else 'damping = "damping.csv"'
    lmbda, mu = lame_parameters(E, NU)
    at_rest = f'E = "{lmbda + 2 * mu} Pa"\nG = "{at_rest_modulus(STIFFNESS) / LAYER * 5e-4} Pa"\n'
    lap = LAP.replace('E = "1 GPa"\nG = "0.4 GPa"\n', at_rest)
    text = plates(lap) + _TEST.format(damping=line) + SEES + _DIAGNOSE + lines
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def diagnosed(rig, models, tmp_path_factory):
    """A function that diagnoses noisy data of a law, with or without its damping."""

    def run(law, damped: bool, lines=ALONE, *, levels=LEVELS, rig=rig, n_modes=2):
        clean = virtual_levels(rig, law, n_modes)
        n = len(levels)
        f = noisy(clean[0], NOISE, np.random.default_rng(1))[:n]
        damping = noisy(clean[1], DAMPING_NOISE, np.random.default_rng(2))[:n] if damped else None
        folder = write(tmp_path_factory.mktemp("levels"), f, damping, levels, lines)
        return diagnose(load_case(folder), MPI.COMM_SELF, keep=models)

    return run


def probabilities(result) -> dict[str, float]:
    """Of the library's effects, of what is left for them beside a cause outside it."""
    found = {e.name: e.probability for e in result.effects}
    assert found["none of these"] < 0.3
    return {name: p / (1 - found["none of these"]) for name, p in found.items()}


def class_of(result, name: str) -> set[str]:
    return set(next(e.class_name for e in result.effects if e.name == name).split(" or "))


# -- what is named ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "cause", "lines", "n_modes"),
    [
        pytest.param(iwan, "micro-slip in the joint", BESIDE, 2, id="iwan"),
        pytest.param(
            elastic, "gapping without slip", BESIDE, 3, id="elastic", marks=pytest.mark.slow
        ),
        pytest.param(
            iwan, "micro-slip in the joint", "", 2, id="iwan, all", marks=pytest.mark.slow
        ),
    ],
)
def test_damping_tells_slip_from_softening(diagnosed, law, cause, lines, n_modes):
    """The cause is named beside the joint's compliance, and what it does at each level is found."""
    result = diagnosed(law, damped=True, lines=lines, n_modes=n_modes)
    assert result.verdict == "cause", result.summary
    # A joint may slip and dissipate next to nothing, at odds of some 20 to 1.
    assert cause in result.summary and (class_of(result, cause) == {cause} or law is elastic)
    p = probabilities(result)
    assert p[cause] > 0.9 and all(p[other] < 0.1 for other in NAMES if other != cause)
    assert all(e.detectable for e in result.effects if e.name == cause)
    assert not {s.effect for s in result.silent} & set(NAMES)
    # A level is predicted from the others: of three values noise alone is beyond this once in a
    # thousand times.
    middle = next(fold for fold in result.shrinkage.folds if fold.name == "level 2 N")
    assert cause in middle.chosen and middle.after < 2.5 * NOISE
    measured, fitted = result.damping
    assert np.std(np.log(fitted / measured)) < 2 * DAMPING_NOISE
    growth = fitted[-1, 0] / fitted[0, 0]
    assert growth > 1.3 if law is iwan else growth == pytest.approx(1.0, abs=1e-6)
    if law is iwan:
        rows = {r["name"]: r for r in result.hypotheses[0].parameters if cause in r["effect"]}
        assert abs(rows["chi"]["value"] - CHI) < rows["chi"]["high"] - rows["chi"]["low"]


def test_without_damping_they_are_one_class(diagnosed):
    result = diagnosed(iwan, damped=False)
    both = {"micro-slip in the joint", "gapping without slip"}
    assert class_of(result, "micro-slip in the joint") == both
    p = probabilities(result)
    assert sum(p[name] for name in both) > 0.9 and max(p[name] for name in both) < 0.9
    split = next(s for s in result.separations if set(s.members) == both)
    assert "damping ratios" in split.measurement
    assert [s.effect for s in result.silent] == [GROWING]


def test_linear_joint_does_not_slip(diagnosed):
    """There is no gap, and nothing that changes with the level."""
    result = diagnosed(linear, damped=True)
    assert result.verdict == "no gap", result.summary
    # Of micro-slip a long integration of the evidence (10,240 draws) gives 0.16 of no gap's.
    p = probabilities(result)
    assert all(p[name] < 0.2 * p["no gap"] for name in NAMES)


def test_one_level_is_silent_and_says_so(diagnosed):
    result = diagnosed(iwan, damped=True, lines=BESIDE, levels=LEVELS[:1])
    assert not set(probabilities(result)) & set(NAMES)
    assert {s.effect for s in result.silent} == set(NAMES)
    assert all("two or more levels" in s.reason for s in result.silent)
    said = result.to_json()["silent"]
    assert [s["effect"] for s in said] == list(NAMES)
    assert "torque" not in str(result.to_json())
    assert result.damping is None


@pytest.mark.slow
def test_no_gap_at_any_level(diagnosed):
    """Plates that are one: frequencies and damping only scatter."""
    result = diagnosed(linear, damped=True, lines=BESIDE, rig=Rig.make(np.inf), n_modes=3)
    assert result.verdict == "no gap", result.summary


# -- closed forms ----------------------------------------------------------------------------------


@pytest.mark.smoke
@pytest.mark.parametrize("amplitude", [0.05, 0.3])
def test_loss_factor_is_that_of_the_loop(amplitude):
    """Segalman's closed form against sliders. Its stiffness is the secant's, a loop's is that of
    its first harmonic: 2 % of the drop apart."""
    stiffness, loss = iwan(amplitude, n=20000, steps=2000)
    drop = amplitude ** (CHI + 1) / (CHI + 2)
    assert 1 - stiffness == pytest.approx(drop, rel=0.025)
    assert loss == pytest.approx(iwan_loss_factor(drop, CHI), rel=0.02)
    assert relative_drop(drop) == pytest.approx(drop, rel=0.02)


@pytest.mark.smoke
def test_damping_slopes_are_those_of_the_prediction():
    """In a model of two springs in series, for which the share's slope is exact."""

    class Series(PointwiseForward):
        """lambda = 1 / (1 / 3 + 1 / G)."""

        def __init__(self):
            self.model = model_of(["lap.G"])

        def __call__(self, values):
            g = values["lap.G"]
            share = (1 / g) / (1 / 3 + 1 / g)
            log_f = -0.5 * np.log(1 / 3 + 1 / g)
            return np.array([log_f, log_f + 1]), np.full((2, 1), 0.5 * share / g)

    effect, base = micro_slip([Zone("lap")], reference=4.0), {"lap.G": 2.0, "lap.E": 1.0}
    hypothesis = Hypothesis((effect,), modes=("a", "b"), damped=True)
    z = np.array([0.7, 0.4, -0.3, 0.6, -0.5, 0.5, 0.2, -0.6])
    assert len(hypothesis.priors) == len(z)

    flat = np.zeros((1, 2))
    evidence = Evidence(np.array([2.0]), flat, flat + 0.01, 0.01, log_damping=flat)
    many = ManyPredictions(hypothesis, Series(), evidence, base)

    def predict(z):
        return at_conditions(hypothesis, Series(), z, [2.0], base, 2).ravel()

    h = 1e-6
    numeric = [(predict(z + s) - predict(z - s)) / (2 * h) for s in h * np.eye(len(z))]
    _, slopes = many.at(z)
    assert slopes == pytest.approx(np.array(numeric).T, rel=1e-5, abs=1e-8)
    # And the damping itself: at rest, plus half of loss factor times share.
    drop, chi, loss, faster, rise = (p.value(x) for p, x in zip(effect.priors, z, strict=False))
    drop = relative_drop(drop * 0.5 ** (1 + chi))
    g = 2.0 * (1 - drop) * (1 + rise * 0.5**2)
    eta = loss * 0.5**faster * iwan_loss_factor(drop, chi)
    at_rest = hypothesis.dampings[0].value(0.2)
    assert np.exp(predict(z)[2]) == pytest.approx(at_rest + 0.5 * eta * (3 / (3 + g)))
