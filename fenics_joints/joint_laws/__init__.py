"""Nonlinear joint laws with memory: for finite-element forms, harmonic balance, time integration.

A law is made of parallel elements, each written once, as UFL. Those here are `Iwan` (sliders that
follow a backbone: `RichardAbbott`, Iranzad and Ahmadian 2012's eq. 4; `Segalman`; `Bilinear`; or
your own), `IwanLayer`, `ElasticFriction` (Jenkins), `CoulombStick` (friction under a normal
load that varies), `DilatantCoulomb` (Iranzad and Ahmadian 2012's eqs. 1-2), `BoucWen` and
`Valanis`; without memory `CubicSpring`, `UnilateralSpring`, `GapSpring`, `RateDamping` and
`FluidFilm`.

In a finite-element model, on a layer of cells or on facets, 2-D or 3-D, serial or parallel::

    law = Iwan(RichardAbbott(E_e=168e6, E_p=1e5, S_y=5.7e5, n=2.5), n_sliders=12)
    joint = JointField.layer(law, u, (0, 0, 1), dx(3), normal_modulus=5e8)
    F = forms.elasticity(u, v, E, nu, dx((1, 2))) + joint.residual - ufl.dot(load, v) * ds(4)

    def apply(newtons):
        load.value[0] = newtons / area

    found = solve_quasi_static(F, u, 100 * np.sin(t), apply, bcs=bcs, joints=[joint])
    found.dissipated, joint.values(joint.slip), joint.dissipation

`JointField.interface` does the same with openings and slips, m, on facets between cells of a space
that can jump there. The tangent is ``ufl.derivative(F, u)``; `LawKernel` is the same law compiled
for the points of a reduced model.

Your own law gives its parameters to the constructor, and writes `JointLaw.element` with
whatever UFL can say, ready-made steps of `fenics_joints.forms.hysteresis` included::

    class WornSlider(JointLaw):
        # A slider whose strength falls with its distance from home.
        def state_size(self, n_slip):
            return n_slip

        def element(self, normal, slip, state, p):
            strength = p["strength"] * ufl.exp(-p["wear"] * ufl.dot(state, state))
            traction, state = forms.slider(slip, state, p["stiffness"], strength)
            return ufl.as_ufl(0.0), traction, state

    law = WornSlider(stiffness=1e9, strength=1e5, wear=1e6)

A law without memory may ask for the rate of strain, as a fifth argument ``rate`` of its element.
It may also tell its energies: ``stored(normal, slip, state, p)``, with the state after the step,
and ``dissipated(normal, slip, old, new, p)`` of the step. Your own backbone is a subclass of
`Backbone` with ``value``, ``slope`` and ``reference``. Parameters may be arrays over parallel
elements, so that two sliders are ``WornSlider(stiffness=[1e9, 2e9], ...)``.

Where one step along a way of slip without reversal gives what many give, as of a slider whose
strength stays, set ``exact_steps = True``: in one direction of slip harmonic balance integrates the
stress exactly then, instead of summing samples.

To compile fast, work with components (``slip[i]``) rather than with vectors: UFL shares the former.
"""

from fenics_joints.joint_laws.field import JointField
from fenics_joints.joint_laws.iwan import (
    Backbone,
    Bilinear,
    RichardAbbott,
    Segalman,
    iwan_sliders,
    slider_edges,
)
from fenics_joints.joint_laws.kernel import HarmonicStress, LawKernel
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.joint_laws.library import (
    BoucWen,
    CoulombStick,
    DilatantCoulomb,
    ElasticFriction,
    Iwan,
    IwanLayer,
    Valanis,
)
from fenics_joints.joint_laws.memoryless import (
    CubicSpring,
    FluidFilm,
    GapSpring,
    RateDamping,
    UnilateralSpring,
)
from fenics_joints.joint_laws.quasi_static import (
    QuasiStatic,
    QuasiStaticHistory,
    solve_quasi_static,
)

__all__ = [
    "Backbone",
    "Bilinear",
    "BoucWen",
    "CoulombStick",
    "CubicSpring",
    "DilatantCoulomb",
    "ElasticFriction",
    "FluidFilm",
    "GapSpring",
    "HarmonicStress",
    "Iwan",
    "IwanLayer",
    "JointField",
    "JointLaw",
    "LawKernel",
    "QuasiStatic",
    "QuasiStaticHistory",
    "RateDamping",
    "RichardAbbott",
    "Segalman",
    "UnilateralSpring",
    "Valanis",
    "iwan_sliders",
    "slider_edges",
    "solve_quasi_static",
]
