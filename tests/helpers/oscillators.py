"""Duffing, Jenkins, absorbers, and a block with contact: small models for harmonic balance."""

import numpy as np
import ufl

from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import CoulombStick, CubicSpring, Iwan, JointLaw, Segalman

TURN = 2 * np.pi
BAND = (0.5 / TURN, 3 / TURN)
CUBIC, FORCE, DAMPING = 1.0, 0.05, 0.02  # of the Duffing oscillator
STICK, SLIDE, PUSH, VISCOUS = 1.0, 0.2, 0.2, 0.05  # of the Jenkins oscillator


class Cubic(JointLaw):
    def element(self, normal, slip, state, p):
        return 0, ufl.as_vector([p["k"] * slip[0] ** 3]), None


class Square(JointLaw):
    def element(self, normal, slip, state, p):
        return 0, ufl.as_vector([p["k"] * slip[0] ** 2]), None


class Jenkins(JointLaw):
    """In one direction, written as a user would."""

    def state_size(self, n_slip):
        return n_slip

    def element(self, normal, slip, state, p):
        trial = p["k"] * (slip[0] - state[0])
        slides = ufl.gt(abs(trial), p["s"])
        traction = ufl.conditional(slides, p["s"] * ufl.sign(trial), trial)
        new = ufl.conditional(slides, slip[0] - traction / p["k"], state[0])
        return 0, ufl.as_vector([traction]), ufl.as_vector([new])


def oscillator(law, c):
    """Unit mass on a unit spring, and the law beside it."""
    one = np.ones((1, 1))
    joint = InterfacePoints("joint", law, one[None], np.ones(1))
    return InterfaceModel(one, one, (joint,), c * one, {"push": one[0]}, {"mass": one[0]})


def duffing():
    return oscillator(Cubic(k=CUBIC), DAMPING)


def jenkins(k=STICK, s=SLIDE):
    return oscillator(Jenkins(k=k, s=s), VISCOUS)


def escape():
    """A well that motions beyond 1 leave: x'' + 0.1 x' + x - x^2 (Thompson 1989)."""
    return oscillator(Square(k=-1.0), 0.1)


def absorber():
    """A Duffing oscillator and its nonlinear tuned absorber (Detroux et al. 2015, sec. 4)."""
    k2, c2, axes = 0.0454, 0.0128, np.eye(2)
    across = np.array([[1.0, -1.0]])
    joints = (
        InterfacePoints("spring", CubicSpring(0.0, 1.0), axes[:1][None], np.ones(1)),
        InterfacePoints("absorber", CubicSpring(0.0, 0.0042), across[None], np.ones(1)),
    )
    between = across.T @ across
    K, C = np.diag([1.0, 0.0]) + k2 * between, np.diag([0.002, 0.0]) + c2 * between
    places = {"push": axes[0]}, {"mass": axes[0], "absorber": axes[1]}
    return InterfaceModel(np.diag([1.0, 0.05]), K, joints, C, *places)


def block(pressure=0.0, n_points=5, seed=0):
    """A body of three directions on a spread of frictional points, and sliders beside them."""
    rng = np.random.default_rng(seed)
    rows = np.tile(np.eye(3), (n_points, 1, 1)) + 0.1 * rng.standard_normal((n_points, 3, 3))
    friction = CoulombStick(3.0, 2.0, 0.3, pressure)
    iwan = Iwan(Segalman(0.5, 2.0, -0.5, 1.0), 6)
    joints = (
        InterfacePoints("floor", friction, rows, np.full(n_points, 1 / n_points), normal=True),
        InterfacePoints("wall", iwan, rows[:2, 1:], np.array([0.4, 0.7])),
    )
    K = np.array([[1.0, 0.1, 0.0], [0.1, 1.0, 0.2], [0.0, 0.2, 1.5]])
    axes = np.eye(3)
    return InterfaceModel(
        np.diag([1.0, 1.2, 0.8]),
        K,
        joints,
        0.03 * K,
        {"x": axes[1], "z": axes[0]},
        {"x": axes[1], "y": axes[2], "z": axes[0]},
    )


def start_of(X, omega, periods=1):
    """Displacements and velocities at the start of a period, by harmonics of displacement (n, K).

    Args:
        X: The harmonics.
        omega: Angular frequency of the force.
        periods: Of the force, that the motion takes.
    """
    h = np.arange(1, X.shape[1] // 2 + 1) / periods
    return np.concatenate([X[:, 0] + X[:, 1::2].sum(axis=1), omega * X[:, 2::2] @ h])
