"""Joints in finite-element models: load steps, energies, and the two kinds of interface."""

from __future__ import annotations

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.integrate import trapezoid
from scipy.optimize import brentq

from fenics_joints import forms
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.joint_laws import (
    CoulombStick,
    DilatantCoulomb,
    Iwan,
    IwanLayer,
    JointField,
    JointLaw,
    RateDamping,
    RichardAbbott,
    Valanis,
    solve_quasi_static,
)

pytestmark = pytest.mark.parallel

CURVE = RichardAbbott(E_e=168.13e6, E_p=1.01e5, S_y=5.7426e5, n=2.5)
SIZE, STEEL = 0.01, 2e14  # blocks so stiff that the joint is the whole of it


class Blocks:
    """Two stiff blocks and a joint between them, the lower held, the upper moved or loaded.

    Args:
        cell: Shape of the cells.
        law: The joint's law, of strain for a layer as thick as the blocks, or of slip.
        layer: Whether the joint is a layer of cells.
        young: Modulus of the blocks, Pa.
        options: For the field.
    """

    def __init__(self, cell, law, layer, young=STEEL, **options):
        self.gdim = 2 if cell in ("triangle", "quadrilateral") else 3
        height = 3 if layer else 2
        top = [*[2 * SIZE, SIZE][: self.gdim - 1], height * SIZE]
        n = [*[2, 1][: self.gdim - 1], height]
        make = mesh.create_rectangle if self.gdim == 2 else mesh.create_box
        self.msh = msh = make(
            MPI.COMM_WORLD,
            [[0.0] * self.gdim, top],
            n,
            mesh.CellType[cell],
            ghost_mode=mesh.GhostMode.shared_facet,
        )
        self.volume = 2 * SIZE * (SIZE if self.gdim == 3 else 1.0) * (SIZE if layer else 1.0)
        element = "Lagrange" if layer else "DG"
        shape = (self.gdim,)
        V = fem.functionspace(
            msh, basix.ufl.element(element, msh.topology.cell_name(), 1, shape=shape)
        )
        self.u, v = fem.Function(V), ufl.TestFunction(V)
        self.moved = fem.Constant(msh, np.zeros(self.gdim))
        self.load = fem.Constant(msh, np.zeros(self.gdim))
        up = [0.0] * (self.gdim - 1) + [1.0]
        if "values" in options:
            options["values"] = options["values"](msh)
        if layer:
            dx = ufl.Measure("dx", msh, subdomain_data=self.tags(0, SIZE, 2 * SIZE))
            self.joint = JointField.layer(law, self.u, up, dx(2), **options)
            self.F = forms.elasticity(self.u, v, young, 0.3, dx(1))
        else:
            dS = ufl.Measure("dS", msh, subdomain_data=self.tags(1, SIZE, SIZE))
            self.joint = JointField.interface(law, self.u, up, dS(2), **options)
            glue = ufl.inner(ufl.jump(self.u), ufl.jump(v)) * dS(1)
            self.F = forms.elasticity(self.u, v, young, 0.3) + 1e18 * glue
        self.F += self.joint.residual
        ends = self.tags(1, height * SIZE, height * SIZE)
        values = np.array(ends.values)
        values[self.tags(1, 0.0, 0.0).find(2)] = 3
        ends = mesh.meshtags(msh, self.gdim - 1, ends.indices, values)
        self.ds = ufl.Measure("ds", msh, subdomain_data=ends)
        self.hold = 1e18 * ufl.inner(self.u, v) * self.ds(3)
        self.drive = 1e18 * ufl.inner(self.u - self.moved, v) * self.ds(2)
        self.v = v

    def tags(self, codim, low, high):
        """Tag 2 for what lies between two heights, 1 for the rest."""
        dim = self.gdim - codim
        for d in (dim, self.gdim):
            self.msh.topology.create_connectivity(dim, d)
        e = 1e-9

        def inside(x):
            return (x[self.gdim - 1] > low - e) & (x[self.gdim - 1] < high + e)

        found = mesh.locate_entities(self.msh, dim, inside)
        entities = self.msh.topology.index_map(dim)
        number = entities.size_local + entities.num_ghosts
        values = np.ones(number, dtype=np.int32)
        values[found] = 2
        return mesh.meshtags(self.msh, dim, np.arange(number, dtype=np.int32), values)

    def mean(self, expression):
        """Form of a mean over the joint."""
        return expression / self.volume * self.joint.dx

    def move(self, steps, **options):
        """Move the top through a history (n, gdim)."""

        def apply(step):
            self.moved.value[:] = step

        outputs = {str(i): self.mean(self.joint.traction[i]) for i in range(self.gdim - 1)}
        outputs["n"] = self.mean(self.joint.stress)
        residual = self.F + self.hold + self.drive
        return solve_quasi_static(
            residual, self.u, steps, apply, joints=[self.joint], outputs=outputs, **options
        )

    def push(self, loads, **options):
        """Load the top, which is free to slide only, along x and, in space, y."""

        def apply(load):
            self.load.value[:-1] = load

        V, z = self.u.function_space, self.gdim - 1
        bottom = fem.locate_dofs_geometrical(V, lambda x: x[z] < 1e-9)
        W, _ = V.sub(z).collapse()
        top = fem.locate_dofs_geometrical((V.sub(z), W), lambda x: x[z] > 3 * SIZE - 1e-9)
        held = fem.dirichletbc(np.zeros(self.gdim), bottom, V)
        level = fem.dirichletbc(fem.Function(W), top, V.sub(z))
        residual = self.F - ufl.dot(self.load, self.v) * self.ds(2)
        given = {"bcs": [held, level], "joints": [self.joint]} | options
        return solve_quasi_static(residual, self.u, loads, apply, **given)


def by_sliders(law, x):
    """Traction (T, d) and heat so far (T,) of sliders along x (T, d), J per area or volume."""
    p, z = law.parameters, np.zeros((law.n_elements, x.shape[1]))
    stress, heat = [], []
    lost = 0.0
    for point in x:
        trial = p["stiffness"][:, None] * (point - z)
        length = np.linalg.norm(trial, axis=1)
        share = np.minimum(1.0, p["strength"] / np.maximum(length, 1e-300))
        new = point - share[:, None] * trial / p["stiffness"][:, None]
        lost += np.sum(share[:, None] * trial * (new - z))
        z = new
        stress.append((share[:, None] * trial).sum(axis=0) + p["spring"].sum() * point)
        heat.append(lost)
    return np.array(stress), np.array(heat)


@pytest.mark.parametrize(
    "cell, layer",
    [(c, True) for c in ("triangle", "quadrilateral", "hexahedron")]
    + [(c, False) for c in ("triangle", "quadrilateral", "tetrahedron")],
)
def test_layer_and_facets_follow_the_sliders(cell, layer):
    """A turning path: tractions, heat, and work, of a law whose sliders are run by hand."""
    law = Iwan(CURVE, 3, thickness=1.0 if layer else SIZE)
    blocks = Blocks(cell, law, layer, normal_modulus=5e8 if layer else 5e10)
    t = np.linspace(0, 2 * np.pi, 33)[1:]
    steps = np.zeros((len(t), blocks.gdim))
    steps[:, 0] = 1.5 * CURVE.reference * SIZE * np.sin(t)
    if blocks.gdim == 3:
        steps[:, 1] = 0.8 * CURVE.reference * SIZE * (1 - np.cos(t))
    found = blocks.move(steps)
    strain = steps[:, :-1] / (SIZE if layer else 1.0)
    stress, heat = by_sliders(law, strain)
    traction = np.stack([found.outputs[str(i)] for i in range(blocks.gdim - 1)], axis=1)
    assert np.allclose(traction, stress, rtol=0, atol=2e-5 * CURVE.S_y)
    assert np.allclose(found.dissipated / blocks.volume, heat, rtol=1e-4, atol=1e-4 * heat[-1])
    # Energy: the work done is what is stored and what is lost, but for the steps' size.
    balance = found.stored + found.dissipated - found.work
    assert np.abs(balance).max() < 0.03 * found.work[-1]
    field = blocks.joint.dissipation.x.array
    largest = blocks.msh.comm.allreduce(field.max(), op=MPI.MAX)
    assert largest == pytest.approx(heat[-1], rel=1e-3)


def order(norms):
    """Order of convergence by the last three norms above round-off."""
    norms = norms[norms > 1e-10 * norms[0]]
    return np.log(norms[-1] / norms[-2]) / np.log(norms[-2] / norms[-3])


@pytest.mark.parametrize("name", ["iwan", "valanis"])
def test_newton_converges_quadratically_under_loads(name):
    """Load control along a turning path in space: order of the last residuals, and the answer."""
    strength = CURVE.S_y
    soft = 1e6 / CURVE.E_e
    law = Iwan(CURVE, 3) if name == "iwan" else Valanis(CURVE.E_e, 1e6, CURVE.E_e / strength)
    blocks = Blocks("hexahedron", law, True, young=2e13, normal_modulus=5e8)
    # The last step asks for what is there already.
    loads = strength * np.array([[0.7, 0.0], [0.75, 0.5], [0.1, 0.9], [0.1, 0.9]])

    slip = {"0": blocks.mean(blocks.joint.slip[0])}
    found = blocks.push(loads, outputs=slip, petsc_options={"snes_rtol": 1e-9})
    orders = [order(r) for r in found.residuals if np.sum(r > 1e-10 * r[0]) >= 3]
    assert orders and max(orders) > 1.8
    assert found.iterations.max() <= 12
    if name == "valanis":  # the first load is straight
        rate = law.parameters["rate"]

        def excess(x):
            stress = 1e6 * x + CURVE.E_e * (1 - soft) * (1 - np.exp(-rate * x)) / rate
            return float(stress - loads[0, 0])

        assert found.outputs["0"][0] == pytest.approx(brentq(excess, 0, 1), rel=1e-4)


def test_more_than_the_joint_can_carry():
    """No equilibrium: PETSc's reason is told, and u is what it was."""
    law = Iwan(RichardAbbott(CURVE.E_e, 0.0, CURVE.S_y, 2.5), 3)
    blocks = Blocks("quadrilateral", law, True, young=2e13, normal_modulus=5e8)

    with pytest.raises(ConvergenceError, match="load step 1") as told:
        blocks.push([0.5 * CURVE.S_y, 1.2 * CURVE.S_y])
    assert "DIVERGED" in str(told.value)
    slip = np.abs(blocks.u.x.array).max()
    assert blocks.msh.comm.allreduce(slip, op=MPI.MAX) < CURVE.reference * SIZE


def test_friction_follows_the_pressure_on_facets():
    """Pressed, slid, pressed harder, and lifted."""
    k_n, k_s, mu = 2e10, 1e10, 0.3
    blocks = Blocks("quadrilateral", CoulombStick(k_n, k_s, mu), False)
    steps = 1e-5 * np.array([[0, -1], [5, -1], [10, -1], [10, -3], [11, -3], [11, 1.0]])
    found = blocks.move(steps)
    pressure = np.maximum(-k_n * steps[:, 1], 0.0)
    z, expected = 0.0, []
    for x, p in zip(steps[:, 0], pressure, strict=True):
        z = np.clip(z, x - mu * p / k_s, x + mu * p / k_s)
        expected.append(k_s * (x - z))
    assert np.allclose(found.outputs["n"], -pressure, rtol=1e-3, atol=1e-3 * pressure.max())
    assert np.allclose(found.outputs["0"], expected, rtol=0, atol=1e-3 * pressure.max())


def test_stretched_layer_with_a_parameter_that_varies():
    """Half as thick as meshed; pressure, and so friction, grows along the layer."""
    k_n, k_s, mu, p0 = 5e8, 2e8, 0.3, 4e5
    blocks = Blocks(
        "quadrilateral",
        CoulombStick(k_n, k_s, mu, p0),
        True,
        degree=4,
        stretch=0.5,
        values=lambda msh: {"pressure": p0 * ufl.SpatialCoordinate(msh)[0] / SIZE},
    )
    steps = SIZE * np.array([[1e-4, 0.0], [2e-3, 0.0], [1e-3, 0.0]])
    found = blocks.move(steps)
    x, w = np.polynomial.legendre.leggauss(3)
    limits = []
    for centre in (0.5, 1.5):  # two cells along the layer, each with its own points
        limits += [(mu * p0 * (centre + 0.5 * a), 0.25 * b) for a, b in zip(x, w, strict=True)]
    expected, heat = np.zeros(3), 0.0
    for limit, share in limits:
        z = 0.0
        for i, strain in enumerate(steps[:, 0] / (0.5 * SIZE)):
            new = np.clip(z, strain - limit / k_s, strain + limit / k_s)
            heat += share * limit * abs(new - z)
            z = new
            expected[i] += share * k_s * (strain - z)
    assert np.allclose(found.outputs["0"], expected, rtol=1e-4)
    assert found.dissipated[-1] == pytest.approx(heat * 0.5 * blocks.volume, rel=1e-4)


class Sticky(JointLaw):
    """A user's law without ``stored`` and ``dissipated``: a slider by its own words."""

    def state_size(self, n_slip):
        return n_slip

    def element(self, normal, slip, state, p):
        traction, state = forms.slider(slip, state, p["k"], p["s"])
        return ufl.as_ufl(0.0), traction, state


def test_energy_of_a_closed_loop():
    """Heat of a law that does not tell it is the loop's area, and the slider's own closed form."""
    k, s, a = 1e8, 2e5, 0.005
    blocks = Blocks("quadrilateral", Sticky(k=k, s=s), True, normal_modulus=5e8, unilateral=True)
    steps = np.zeros((320, 2))
    steps[:, 0] = a * SIZE * np.sin(np.linspace(0, 4 * np.pi, 321))[1:]
    found = blocks.move(steps)
    loop = (found.dissipated[-1] - found.dissipated[159]) / blocks.volume
    assert loop == pytest.approx(4 * s * (a - s / k), rel=2e-3)
    strain, stress = steps[159:, 0] / SIZE, found.outputs["0"][159:]
    assert loop == pytest.approx(trapezoid(stress, strain), rel=1e-4)
    assert np.isnan(found.stored[0])


@pytest.mark.parametrize(
    "law",
    [
        CoulombStick(2e10, 1e10, 0.3, 1e6),
        DilatantCoulomb(2e10, 1e10, 0.3, 1e6),
        IwanLayer(CURVE, 6e7, 3, thickness=SIZE),
        Valanis(1e10, 1e8, 5e4),
    ],
    ids=lambda law: law.name,
)
def test_work_is_stored_or_lost(law):
    """Opening and slip out of phase: the balance closes as steps shrink, and heat never falls."""
    normal = {} if law.coupled else {"normal_modulus": 2e10}
    gaps = []
    for number in (40, 160):
        blocks = Blocks("quadrilateral", law, False, **normal)
        t = np.linspace(0, 2.5 * np.pi, number + 1)[1:]
        steps = 1e-4 * np.column_stack([np.sin(t), 0.3 * np.sin(1.7 * t)])
        found = blocks.move(steps)
        scale = np.abs(found.work).max()
        gaps.append(np.abs(found.stored + found.dissipated - found.work).max() / scale)
        assert np.diff(found.dissipated).min() > -1e-6 * scale
    # Valanis' heat is what the balance leaves, and only has to grow.
    assert gaps[1] < 0.02 and gaps[1] < max(0.5 * gaps[0], 1e-12)
    # Sliding that opens gives back, against the pressure, all that friction takes.
    assert (found.dissipated[-1] > 0.05 * scale) != (law.name == "dilatant_coulomb")


def test_bad_input_is_named():
    blocks = Blocks("quadrilateral", Iwan(CURVE, 1), True)
    dx = ufl.Measure("dx", blocks.msh)
    for law, options, word in (
        (Sticky(k=np.ones((4, 1)), s=1.0), {}, "point to point"),
        (CoulombStick(1e9, 1e9, 0.3), {"normal_modulus": 1.0}, "normal stress of its own"),
        (Iwan(CURVE, 1), {"values": {"k": 1.0}}, "no parameter 'k'"),
    ):
        with pytest.raises(InputError, match=word):
            JointField.layer(law, blocks.u, [0, 1], dx, **options)
    with pytest.raises(InputError, match="normal"):
        JointField.layer(Iwan(CURVE, 1), blocks.u, [0, 0, 1], dx)


def test_a_law_with_the_rate_takes_that_of_the_step():
    """Simple shear of a square in one step of 0.5 s: cubic damping, and work by the trapezoid."""
    msh = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    u = fem.Function(fem.functionspace(msh, ("Lagrange", 1, (2,))))
    law, dx = RateDamping(c1=1.0, c3=2.0), ufl.Measure("dx", msh)
    with pytest.raises(InputError, match="expected a step"):
        JointField.layer(law, u, [0, 1], dx)
    joint = JointField.layer(law, u, [0, 1], dx, step=0.5)
    u.interpolate(lambda x: np.array([0.1 * x[1], 0.0 * x[0]]))
    rate, traction = 0.2, 0.2 + 2 * 0.2**3
    virtual = fem.assemble_scalar(fem.form(ufl.action(joint.residual, u)))
    virtual = msh.comm.allreduce(virtual)
    assert virtual == pytest.approx(traction * rate * 0.5, rel=1e-4)
    joint.update()
    assert joint.work == pytest.approx(0.5 * traction * 0.1, rel=1e-4)
