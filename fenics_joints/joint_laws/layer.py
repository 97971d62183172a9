"""A thin layer that yields in tension and shear together, as an elasto-plastic material does."""

from __future__ import annotations

import ufl

from fenics_joints.errors import real
from fenics_joints.joint_laws.iwan import Backbone
from fenics_joints.joint_laws.library import Iwan


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
