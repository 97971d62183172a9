"""The joint laws with memory that come with the suite."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np
import ufl
from numpy.typing import ArrayLike

from fenics_joints.errors import InputError, real, whole
from fenics_joints.forms.hysteresis import (
    bouc_wen,
    coulomb_stick,
    dilatant_coulomb,
    slider,
    slider_dissipation,
    slider_energy,
    valanis,
)
from fenics_joints.joint_laws.iwan import Backbone, check_backbone, iwan_sliders, slider_edges
from fenics_joints.joint_laws.law import JointLaw, not_negative, positive


def _split(state, n: int):
    """A state as its first ``n`` numbers and the rest, two vectors."""
    size = state.ufl_shape[0]
    first = ufl.as_vector([state[i] for i in range(n)])
    return first, ufl.as_vector([state[i] for i in range(n, size)])


class ElasticFriction(JointLaw):
    """Elastic dry friction under a constant normal load: Jenkins' element.

    A spring that slides at its strength, in one direction or in two of a plane. `CoulombStick` has
    a normal load that varies.

    Args:
        stiffness: Stiffness of sticking, k.
        strength: Traction, or force, of sliding: friction times the normal load; >= 0.
    """

    name = "elastic_friction"
    exact_steps = True

    def __init__(self, stiffness: ArrayLike, strength: ArrayLike):
        super().__init__(stiffness=stiffness, strength=strength)

    def check(self) -> None:
        positive(self, "stiffness")
        not_negative(self, "strength")

    def state_size(self, n_slip: int) -> int:
        return n_slip

    def element(self, normal, slip, state, p):
        traction, state = slider(slip, state, p["stiffness"], p["strength"])
        return ufl.as_ufl(0.0), traction, state

    def stored(self, normal, slip, state, p):
        """Energy per area in the spring, with the state after the step."""
        return slider_energy(slip, state, p["stiffness"])

    def dissipated(self, normal, slip, old, new, p):
        """Energy per area turned to heat in a step."""
        return slider_dissipation(slip, old, new, p["stiffness"])


class Iwan(ElasticFriction):
    """Parallel sliders that follow a backbone: microslip, macroslip, Masing's loops.

    Args:
        backbone: Stress by shear strain of the layer, or by slip of a zero-thickness interface,
            or force by slip of a discrete joint.
        n_sliders: Number of sliders, see `fenics_joints.joint_laws.iwan` for what it buys.
        amplitudes: Least and largest amplitude of interest, of strain; 0.1 and 2 times the
            backbone's reference strain by default.
        thickness: For a backbone by strain on an interface of no thickness: the thickness, m, of
            the layer that the interface stands for, whose strain is slip over thickness.

    Raises:
        InputError: For a backbone that is not concave, or numbers out of range.

    Attributes:
        backbone: The backbone.
        edges: Edges of the sliders' bins, in units of the backbone's reference strain; `change`
            keeps them, so that the response is a smooth function of the parameters.
    """

    name = "iwan"

    def __init__(
        self,
        backbone: Backbone,
        n_sliders: int = 24,
        *,
        amplitudes: tuple[float, float] | None = None,
        thickness: float = 1.0,
    ):
        check_backbone(backbone)
        real(f"{self.name}.thickness", thickness, "m", above=0)
        self.n_sliders, self.thickness = n_sliders, thickness
        self.edges = slider_edges(backbone, n_sliders, amplitudes) / backbone.reference
        self._make(backbone)

    def _make(self, backbone: Backbone) -> None:
        """The elements of a backbone, with the bins that are there."""
        self.backbone = backbone
        edges = np.minimum(self.edges * backbone.reference, backbone.limit)
        stiffness, strength = iwan_sliders(backbone, self.n_sliders, edges=edges)
        # The first element carries the spring beside the sliders.
        spring = np.zeros(len(stiffness))
        spring[0] = backbone.final_slope
        JointLaw.__init__(
            self,
            stiffness=stiffness / self.thickness,
            strength=strength,
            spring=spring / self.thickness,
            **self._more(),
        )

    #: Numbers that it has beside its backbone's.
    _own: ClassVar[tuple[str, ...]] = ()

    def _more(self) -> dict[str, float]:
        """Further element parameters.

        Raises:
            InputError: If a number of its own is out of range.
        """
        return {}

    def change(self, **values: float) -> Iwan:
        """The same law with other values of some of the backbone's parameters, or of its own.

        Raises:
            InputError: For an unknown parameter or one out of range.
        """
        own = {key: values.pop(key) for key in self._own if key in values}
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__, **own)  # the compiled kernels too
        other._make(self.backbone.change(**values))
        return other

    def with_amplitudes(self, amplitudes: tuple[float, float]) -> Iwan:
        """The same law with its sliders for other amplitudes, least and largest, of strain.

        Raises:
            InputError: As the constructor.
        """
        other = object.__new__(type(self))
        edges = slider_edges(self.backbone, self.n_sliders, amplitudes)
        other.__dict__.update(self.__dict__, edges=edges / self.backbone.reference)
        other._make(self.backbone)
        return other

    def element(self, normal, slip, state, p):
        zero, traction, state = super().element(normal, slip, state, p)
        return zero, traction + p["spring"] * slip, state

    def stored(self, normal, slip, state, p):
        """Energy per volume or area in the springs, with the state after the step."""
        spring = 0.5 * p["spring"] * ufl.dot(slip, slip)
        return spring + super().stored(normal, slip, state, p)


class CoulombStick(JointLaw):
    """Elastic sticking and Coulomb friction under a varying, one-sided pressure.

    Displacements are measured from a state in which the interface carries ``pressure`` and the
    structure is at rest: the normal stress it returns is what comes on top, so that no load has to
    hold it. With ``pressure`` 0 it is the whole of it.

    Args:
        normal_stiffness: k_n, Pa/m (zero thickness) or Pa (layer).
        tangential_stiffness: k_s, alike.
        friction: Coefficient of friction, >= 0.
        pressure: Pressure, Pa, in the state of rest; a number or one for each point, (P, 1). Where
            a gap is open it is negative: minus k_n times the gap.
    """

    name = "coulomb"
    exact_steps = True
    coupled = True

    def __init__(
        self,
        normal_stiffness: ArrayLike,
        tangential_stiffness: ArrayLike,
        friction: ArrayLike,
        pressure: ArrayLike = 0.0,
    ):
        super().__init__(
            normal_stiffness=normal_stiffness,
            tangential_stiffness=tangential_stiffness,
            friction=friction,
            pressure=pressure,
        )

    def check(self) -> None:
        positive(self, "normal_stiffness", "tangential_stiffness")
        not_negative(self, "friction")

    def state_size(self, n_slip: int) -> int:
        return n_slip

    def element(self, normal, slip, state, p):
        sigma, traction, state = coulomb_stick(
            normal,
            slip,
            state,
            p["normal_stiffness"],
            p["tangential_stiffness"],
            p["friction"],
            p["pressure"],
        )
        return sigma + ufl.max_value(p["pressure"], 0.0), traction, state

    def stored(self, normal, slip, state, p, opened=0):
        """Energy per area in the springs, above that of the state of rest without tension.

        Arguments as `JointLaw.stored`, and what sliding has ``opened``.
        """
        k_n, rest = p["normal_stiffness"], ufl.max_value(p["pressure"], 0.0)
        pressed = ufl.max_value(p["pressure"] - k_n * (normal - opened), 0.0)
        work = (pressed**2 - rest**2) / (2.0 * k_n) + rest * normal
        return work + slider_energy(slip, state, p["tangential_stiffness"])

    def dissipated(self, normal, slip, old, new, p):
        """Energy per area turned to heat in a step, with the friction at its end."""
        return slider_dissipation(slip, old, new, p["tangential_stiffness"])


class DilatantCoulomb(CoulombStick):
    """Coulomb friction whose sliding opens the interface: Iranzad and Ahmadian 2012, eqs. 1-2.

    It dissipates nothing, for the pressure gets back what friction takes. Arguments as
    `CoulombStick`; see `fenics_joints.forms.hysteresis.dilatant_coulomb`.
    """

    name = "dilatant_coulomb"
    exact_steps = False

    def state_size(self, n_slip: int) -> int:
        return n_slip + 1

    def element(self, normal, slip, state, p):
        n = slip.ufl_shape[0]
        position, _ = _split(state, n)
        sigma, traction, position, opened = dilatant_coulomb(
            normal,
            slip,
            position,
            state[n],
            p["normal_stiffness"],
            p["tangential_stiffness"],
            p["friction"],
            p["pressure"],
        )
        new = ufl.as_vector([*(position[i] for i in range(n)), opened])
        return sigma + ufl.max_value(p["pressure"], 0.0), traction, new

    def stored(self, normal, slip, state, p):
        """Energy per area in the springs, above that of the state of rest."""
        n = slip.ufl_shape[0]
        return super().stored(normal, slip, _split(state, n)[0], p, opened=state[n])

    def dissipated(self, normal, slip, old, new, p):
        """Energy per area turned to heat in a step: stress at its end times plastic way."""
        n = slip.ufl_shape[0]
        (before, _), (after, _) = _split(old, n), _split(new, n)
        sigma = p["normal_stiffness"] * (normal - new[n]) - p["pressure"]
        way = new[n] - old[n]
        return sigma * way + slider_dissipation(slip, before, after, p["tangential_stiffness"])


class _InternalSlip(JointLaw):
    """Stress of an elastic share of the slip x, and of an internal variable z that follows it."""

    def state_size(self, n_slip: int) -> int:
        return 2 * n_slip

    @abstractmethod
    def moduli(self, p) -> tuple:
        """Stiffness of x, and of z."""

    @abstractmethod
    def internal(self, slip, last, z, p):
        """z after a step from the slip ``last``."""

    def element(self, normal, slip, state, p):
        n, (k_x, k_z) = slip.ufl_shape[0], self.moduli(p)
        z = self.internal(slip, *_split(state, n), p)
        traction = ufl.as_vector([k_x * slip[i] + k_z * z[i] for i in range(n)])
        return ufl.as_ufl(0.0), traction, ufl.as_vector([*slip, *(z[i] for i in range(n))])

    def stored(self, normal, slip, state, p):
        """Recoverable energy per volume or area: that of the spring and that of z."""
        _, z = _split(state, slip.ufl_shape[0])
        k_x, k_z = self.moduli(p)
        return 0.5 * (k_x * ufl.dot(slip, slip) + k_z * ufl.dot(z, z))


class BoucWen(_InternalSlip):
    """Bouc and Wen's smooth hysteresis, isotropic: k (a x + (1 - a) z).

    The energy of z is chosen so that the heat, (1 - a) k z (dx - dz), is not negative for
    |gamma| <= beta (Erlicher and Point, C. R. Mecanique 332, 2004).

    Args:
        stiffness: Stiffness at rest, k.
        ratio: Share a of it that stays, 0 <= a <= 1.
        beta: Parameter of z, 1/slip^n.
        gamma: Parameter of z, at most beta in size.
        n: Exponent, >= 1.
        substeps: Exponential midpoint steps within each step.
    """

    name = "bouc_wen"

    def __init__(
        self,
        stiffness: ArrayLike,
        ratio: ArrayLike,
        beta: ArrayLike,
        gamma: ArrayLike,
        n: ArrayLike = 1.0,
        *,
        substeps: int = 1,
    ):
        super().__init__(stiffness=stiffness, ratio=ratio, beta=beta, gamma=gamma, n=n)
        self.substeps = whole("bouc_wen.substeps", substeps)

    def check(self) -> None:
        positive(self, "stiffness", "beta")
        not_negative(self, "ratio")
        p = self.parameters
        if np.any(p["ratio"] > 1) or np.any(p["n"] < 1) or np.any(abs(p["gamma"]) > p["beta"]):
            raise InputError("bouc_wen: expected ratio <= 1, n >= 1 and |gamma| <= beta.")

    def moduli(self, p) -> tuple:
        return p["stiffness"] * p["ratio"], p["stiffness"] * (1.0 - p["ratio"])

    def internal(self, slip, last, z, p):
        return bouc_wen(slip, last, z, p["beta"], p["gamma"], p["n"], substeps=self.substeps)


class Valanis(_InternalSlip):
    """Valanis' endochronic law in its simplest form, isotropic: E_t x + (E_0 - E_t) z.

    Arrays of moduli and rates make a series of memories, side by side.

    Args:
        E_0: Stiffness at rest.
        E_t: Stiffness at large slip, < E_0.
        rate: Rate at which the past is forgotten, 1/slip; (E_0 - E_t) / rate is the strength.
    """

    name = "valanis"
    exact_steps = True

    def __init__(self, E_0: ArrayLike, E_t: ArrayLike, rate: ArrayLike):
        super().__init__(E_0=E_0, E_t=E_t, rate=rate)

    def check(self) -> None:
        positive(self, "E_0", "rate")
        not_negative(self, "E_t")
        if np.any(self.parameters["E_t"] >= self.parameters["E_0"]):
            raise InputError("valanis: expected E_t < E_0.")

    def moduli(self, p) -> tuple:
        return p["E_t"], p["E_0"] - p["E_t"]

    def internal(self, slip, last, z, p):
        return valanis(slip, last, z, p["rate"])


class IwanLayer(Iwan):
    """Parallel sliders in the space of normal stress and shear, with von Mises' equivalent stress.

    It is what a finite-element program makes of Iranzad and Ahmadian 2012's eq. 4 when it is given
    as the uniaxial curve of a plastic material: the curve holds for tension across the layer alone,
    and in shear alone the traction is 1/sqrt(3) of it. The return is radial in stress: the closest
    point for E = 3 G, which the paper's layer (E = 2.97 G) nearly has; the dissipation is never
    negative.

    Args:
        backbone: Equivalent stress by normal strain; its slope at rest is E of the layer.
        G: Shear modulus of the layer at rest, Pa; at large strain it falls in proportion to E.
        n_sliders: Number of sliders.
        amplitudes: Least and largest amplitude of interest, of strain; 0.1 and 2 times the
            backbone's reference strain by default.
        thickness: As in `Iwan`.

    Raises:
        InputError: For a backbone that is not concave, or numbers out of range.

    Attributes:
        backbone: The backbone.
        G: Shear modulus at rest, Pa.
    """

    name = "iwan_layer"
    exact_steps = False  # it slides in normal strain and shear together
    coupled = True
    _own = ("G",)

    def __init__(
        self,
        backbone: Backbone,
        G: float,
        n_sliders: int = 24,
        *,
        amplitudes: tuple[float, float] | None = None,
        thickness: float = 1.0,
    ):
        self.G = real(f"{self.name}.G", G, "Pa", above=0)
        super().__init__(backbone, n_sliders, amplitudes=amplitudes, thickness=thickness)

    def _more(self) -> dict[str, float]:
        real(f"{self.name}.G", self.G, "Pa", above=0)
        return {"ratio": self.G / float(self.backbone.slope(0.0))}

    def state_size(self, n_slip: int) -> int:
        return n_slip + 1

    def element(self, normal, slip, state, p):
        n, k, g = slip.ufl_shape[0], p["stiffness"], p["ratio"] * p["stiffness"]
        sigma = k * (normal - state[0])
        tau = [g * (slip[i] - state[1 + i]) for i in range(n)]
        square = sigma**2 + 3.0 * sum(t**2 for t in tau)
        slides = ufl.gt(square, p["strength"] ** 2)
        size = ufl.sqrt(ufl.conditional(slides, square, p["strength"] ** 2))
        share = ufl.conditional(slides, p["strength"] / size, 1.0)
        sigma, tau = share * sigma, [share * t for t in tau]
        moved = [normal - sigma / k, *(slip[i] - t / g for i, t in enumerate(tau))]
        new = ufl.as_vector([ufl.conditional(slides, m, state[i]) for i, m in enumerate(moved)])
        traction = [t + p["ratio"] * p["spring"] * slip[i] for i, t in enumerate(tau)]
        return sigma + p["spring"] * normal, ufl.as_vector(traction), new

    def stored(self, normal, slip, state, p):
        """Energy per volume or area in the springs, with the state after the step."""
        n = slip.ufl_shape[0]
        energy = 0.5 * p["stiffness"] * (normal - state[0]) ** 2 + 0.5 * p["spring"] * normal**2
        for i in range(n):
            apart, modulus = slip[i] - state[1 + i], p["ratio"]
            energy += 0.5 * modulus * (p["stiffness"] * apart**2 + p["spring"] * slip[i] ** 2)
        return energy

    def dissipated(self, normal, slip, old, new, p):
        """Energy per volume or area turned to heat in a step: stress at its end times its way."""
        k, g = p["stiffness"], p["ratio"] * p["stiffness"]
        heat = k * (normal - new[0]) * (new[0] - old[0])
        for i in range(slip.ufl_shape[0]):
            heat += g * (slip[i] - new[1 + i]) * (new[1 + i] - old[1 + i])
        return heat
