"""Laws without memory: springs with gaps or cubic terms, damping by the rate of motion."""

from __future__ import annotations

import ufl
from numpy.typing import ArrayLike

from fenics_joints.errors import InputError
from fenics_joints.forms.hysteresis import vector_length
from fenics_joints.joint_laws.law import JointLaw, not_negative, positive


class UnilateralSpring(JointLaw):
    """Stop of a spring without memory, met beyond a gap: k max(x - gap, 0), along one line.

    Pressing where x is positive; a row of the other sign turns it round. On the normal of a contact
    `CoulombStick` is the same, with minus k_n times the gap for its pressure.

    Args:
        stiffness: k.
        gap: Way to the stop; a spring that is pressed at rest has a negative one.
    """

    name = "unilateral"

    def __init__(self, stiffness: ArrayLike, gap: ArrayLike = 0.0):
        super().__init__(stiffness=stiffness, gap=gap)

    def check(self) -> None:
        positive(self, "stiffness")

    def element(self, normal, slip, state, p):
        if slip.ufl_shape[0] != 1:
            raise InputError(
                f"{self.label}: {slip.ufl_shape[0]} components of slip; expected one, as a stop is "
                "met along a line (GapSpring is met all round)."
            )
        beyond = ufl.max_value(slip[0] - p["gap"], 0.0)
        return ufl.as_ufl(0.0), ufl.as_vector([p["stiffness"] * beyond]), None

    def stored(self, normal, slip, state, p):
        """Energy per area in the spring."""
        return 0.5 * p["stiffness"] * ufl.max_value(slip[0] - p["gap"], 0.0) ** 2


class GapSpring(JointLaw):
    """Spring without memory that is met beyond a gap to all sides: k max(|x| - gap, 0) x / |x|.

    Args:
        stiffness: k.
        gap: Way to the stop, >= 0.
    """

    name = "gap"

    def __init__(self, stiffness: ArrayLike, gap: ArrayLike):
        super().__init__(stiffness=stiffness, gap=gap)

    def check(self) -> None:
        positive(self, "stiffness")
        not_negative(self, "gap")

    def element(self, normal, slip, state, p):
        n = slip.ufl_shape[0]
        if n == 1:
            # By two stops, so that their switches are smooth functions of the slip.
            x, g = slip[0], p["gap"]
            beyond = ufl.max_value(x - g, 0.0) - ufl.max_value(-x - g, 0.0)
            return ufl.as_ufl(0.0), ufl.as_vector([p["stiffness"] * beyond]), None
        length = vector_length(slip)
        met = ufl.gt(length, p["gap"])
        share = ufl.conditional(met, 1.0 - p["gap"] / ufl.conditional(met, length, 1.0), 0.0)
        traction = [p["stiffness"] * share * slip[i] for i in range(n)]
        return ufl.as_ufl(0.0), ufl.as_vector(traction), None

    def stored(self, normal, slip, state, p):
        """Energy per area in the spring."""
        beyond = ufl.max_value(vector_length(slip) - p["gap"], 0.0)
        return 0.5 * p["stiffness"] * beyond**2


class CubicSpring(JointLaw):
    """Spring without memory: (k1 + k3 |x|^2) x.

    Args:
        k1: Stiffness at rest.
        k3: Cubic stiffness; negative softens.
    """

    name = "cubic"

    def __init__(self, k1: ArrayLike, k3: ArrayLike):
        super().__init__(k1=k1, k3=k3)

    def element(self, normal, slip, state, p):
        square = ufl.dot(slip, slip)
        return ufl.as_ufl(0.0), (p["k1"] + p["k3"] * square) * slip, None

    def stored(self, normal, slip, state, p):
        """Energy per area in the spring."""
        square = ufl.dot(slip, slip)
        return 0.5 * p["k1"] * square + 0.25 * p["k3"] * square**2


class RateDamping(JointLaw):
    """Damping by the rate of slip, without memory: c1 v + c3 |v|^2 v + s tanh(v / v0) v / |v|.

    Args:
        c1: Viscous damping.
        c3: Cubic damping.
        strength: Friction, smoothed; 0 for none.
        smoothing: Rate v0 of slip below which friction falls off.
    """

    name = "rate_damping"

    def __init__(
        self,
        c1: ArrayLike = 0.0,
        c3: ArrayLike = 0.0,
        strength: ArrayLike = 0.0,
        smoothing: ArrayLike = 1.0,
    ):
        super().__init__(c1=c1, c3=c3, strength=strength, smoothing=smoothing)

    def check(self) -> None:
        not_negative(self, "c1", "c3", "strength")
        positive(self, "smoothing")

    def element(self, normal, slip, state, p, rate):
        n = slip.ufl_shape[0]
        v = [rate[1 + i] for i in range(n)]
        square = sum(w**2 for w in v)
        small = (1e-4 * p["smoothing"]) ** 2
        speed = ufl.sqrt(square + small)
        # tanh by what does not overflow: UFL's derivative of it is not finite beyond 355.
        fallen = ufl.exp(-2.0 * speed / p["smoothing"])
        friction = p["strength"] * (1.0 - fallen) / (1.0 + fallen) / speed
        factor = p["c1"] + p["c3"] * square + friction
        return ufl.as_ufl(0.0), ufl.as_vector([factor * w for w in v]), None


class FluidFilm(JointLaw):
    """A thin film of oil between parallel faces, full and incompressible, as stress on the area.

    Squeezed by eta b^2 w' / (h + w)^3, as a long strip open along both edges is, and sheared by
    eta v / (h + w) (Reynolds' equation; Hamrock, Schmid and Jacobson, Fundamentals of Fluid Film
    Lubrication, 2004). It carries tension too: where it would cavitate, too much.

    Args:
        viscosity: eta, Pa s.
        thickness: h at rest, m.
        width: b of the strip, m; of a disc of radius R, R sqrt(3 / 2).
    """

    name, coupled = "fluid_film", True

    def __init__(self, viscosity: ArrayLike, thickness: ArrayLike, width: ArrayLike):
        super().__init__(viscosity=viscosity, thickness=thickness, width=width)

    def check(self) -> None:
        positive(self, "viscosity", "thickness", "width")

    def element(self, normal, slip, state, p, rate):
        eta, h = p["viscosity"], p["thickness"] + normal
        shear = [eta * rate[1 + i] / h for i in range(slip.ufl_shape[0])]
        return eta * p["width"] ** 2 * rate[0] / h**3, ufl.as_vector(shear), None
