"""Reduced models with nonlinear interfaces against the full models they stand for."""

from __future__ import annotations

import dolfinx.io
import h5py
import numpy as np
import pytest
import scipy.linalg
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interfaces import (
    read_interface_model,
    reduce_contacts,
    reduce_layers,
    with_modal_damping,
    with_rayleigh_damping,
)
from fenics_joints.joint_laws import Iwan, JointLaw, RichardAbbott
from fenics_joints.meshes import lap_plates, stacked_blocks
from fenics_joints.modal import solve_modes
from fenics_joints.preload import (
    OPEN,
    SLIP,
    Contact,
    PreloadModel,
    WasherForce,
)
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.structure import (
    Parameter,
    PointMass,
    Sensors,
    Spring,
    Structure,
    Support,
    joint,
    part,
)

E, G = 1e9, 3e8
N = 14
TIP, END = ((0.1, 0.02, 0.0), (0.0, 0.0, 1.0)), ((0.32, 0.06, 0.0165), (0.0, 0.6, 0.8))
PLACES = {"forces": {"tip": TIP, "end": END}, "sensors": {"tip": TIP, "end": END}}


class Stick(JointLaw):
    """A linear spring in the tangent plane."""

    def element(self, normal, slip, state, p):
        return ufl.as_ufl(0.0), p["k"] * slip, None


class Bond(JointLaw):
    """Linear springs in all directions."""

    coupled = True

    def element(self, normal, slip, state, p):
        return p["k_n"] * normal, p["k"] * slip, None


def plates(comm=MPI.COMM_WORLD, law="uncoupled", cell="hexahedron", held=False, degree=2):
    """Lap plates with a soft layer, free or clamped at an end, with something on them."""
    parts = part("plates", ("plate_1", "plate_2"), E="E", nu=0.3, rho=2750.0)
    layer = joint(
        "layer", ("joint_near", "joint_away"), E="layer.E", G="layer.G", stretch="s", law=law
    )
    return Structure(
        lap_plates(comm, element_size=0.04, n_thickness=1, cell=cell),
        [parts, layer],
        [Parameter("E", 7e10), Parameter("layer.E", 8e8), Parameter("layer.G", G),
         Parameter("s", 1.0), Parameter("m", 0.02)],
        masses=[PointMass("tip", "m", (0.01, 0.03, 0.0))],
        springs=[Spring("cord", 1e4, (0.02, 0.0, 0.004), (0.0, 1.0, 0.0))],
        supports=[Support("end_1")] if held else [],
        degree=degree,
    )  # fmt: skip


def relative(found, exact, n_rigid=0):
    """Errors of the elastic frequencies, (n,)."""
    return found.frequencies_hz[n_rigid:] / exact.frequencies_hz[n_rigid:] - 1


def blocks(comm=MPI.COMM_WORLD, degree=2, bolts=()):
    """Two free bars, one on the other."""
    x, y, h = np.linspace(0.0, 0.2, 9), np.linspace(0.0, 0.02, 3), np.linspace(0.0, 0.01, 2)
    mesh = stacked_blocks(comm, lower=(x, y, -h[::-1]), upper=h)
    bars = part("bars", ("lower", "upper"), E="E", nu=0.3, rho=7800.0)
    structure = Structure(mesh, [bars], [Parameter("E", 2e11)], degree=degree)
    pads = Contact("pads", "interface_lower", "interface_upper")
    return PreloadModel(structure, [pads], bolts)


def sprung(model, k_n, k):
    areas = model.interfaces[0].areas
    return LinearJoint(model, springs={"pads": np.column_stack([areas * k_n, areas * k])})


# -- layers ----------------------------------------------------------------------------------------


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("linear", "law"),
    [
        ("uncoupled", Stick(k=G)),
        ("constrained", Stick(k=G)),
        ("uncoupled", Bond(k_n=8e8, k=G)),
        # lambda + 2 mu of E = 8e8, G = 3e8: nu = 1/3, lambda = 2 G.
        ("constrained", Bond(k_n=4 * G, k=G)),
    ],
)
def test_a_law_as_stiff_as_the_layer_gives_the_linear_structure(linear, law):
    structure = plates(law=linear)
    exact = solve_modes(structure, n_modes=N)
    model = reduce_layers(structure, {"layer": law}, n_modes=N, interface_modes=4)
    modes = solve_modes(model, n_modes=N)
    assert modes.n_rigid == exact.n_rigid == 5
    # Two points along a cell of 40 mm and one through it see nearly all of the stress.
    found = relative(modes, exact, 5)
    assert (-1e-3 if law.coupled else -1e-4) < found.min() and found.max() < 1e-6
    assert model.total_mass() == pytest.approx(structure.total_mass(), rel=1e-12)
    # The points carry the layer's whole volume; without them nothing is unstable.
    points = model.interfaces[0]
    assert points.weights.sum() == pytest.approx(0.08 * 0.08 * 0.5e-3, rel=1e-12)
    assert np.linalg.eigvalsh(model.K).min() > -1e-9 * np.linalg.eigvalsh(model.K).max()


@pytest.mark.parallel
@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 2), ("tetrahedron", 1)])
def test_a_softer_law_is_a_softer_layer_and_interface_modes_converge(cell, degree):
    """Basis at G, law at G / 10: the full model's frequencies at G / 10, which it never saw."""
    structure = plates(cell=cell, degree=degree)
    exact = solve_modes(structure, {"layer.G": 0.1 * G}, n_modes=11)
    worst = []
    for n in (2, 10, 32):
        law = {"layer": Stick(k=0.1 * G)}
        model = reduce_layers(structure, law, n_modes=30, interface_modes=n)
        worst.append(relative(solve_modes(model, n_modes=11), exact, 5).max())
    assert worst[0] > 4 * worst[1] > 16 * worst[2]
    assert worst[2] < 5e-4


def response(structure, given, omega, place):
    """Displacement at END of the full model under a unit force at a place."""
    K, M = structure.stiffness(given), structure.mass(given)
    K.axpy(-(omega**2), M)
    load, x = K.createVecs()
    gdim, (point, direction) = structure.gdim, place
    rows, imap = structure.rows(point), structure.V.dofmap.index_map
    for nodes, values in zip(rows.nodes, rows.values, strict=True):
        for i in range(gdim):
            numbers = imap.local_to_global(nodes) * gdim + i
            add = PETSc.InsertMode.ADD_VALUES
            load.setValues(numbers.astype(np.int32), values * direction[i], add)
    load.assemble()
    ksp = PETSc.KSP().create(structure.comm)
    ksp.setOperators(K)
    ksp.setType("preonly"), ksp.getPC().setType("lu"), ksp.getPC().setFactorSolverType("mumps")
    ksp.solve(load, x)
    found = structure.observe([x], Sensors([END[0]], [END[1]]))[0, 0]
    ksp.destroy(), K.destroy(), M.destroy()
    return found


@pytest.mark.parallel
def test_static_and_dynamic_response_are_the_full_models():
    """A clamped lap, its layer five times softer than the basis was made for."""
    structure, soft = plates(held=True), {"layer.G": 0.2 * G}
    law = {"layer": Stick(k=0.2 * G)}
    model = reduce_layers(structure, law, n_modes=30, interface_modes=40, **PLACES)
    first = solve_modes(model, n_modes=2).frequencies_hz
    for hertz, error in ((0.0, 2e-4), (0.5 * first[0], 2e-4), (np.mean(first), 3e-3)):
        omega = 2 * np.pi * hertz
        A = model.stiffness_at_rest() - omega**2 * model.M
        for name, place in (("tip", TIP), ("end", END)):
            x = np.linalg.solve(A, model.row("forces", name))
            exact = response(structure, soft, omega, place)
            assert model.row("sensors", "end") @ x == pytest.approx(exact, rel=error), name
    # At the basis' own stiffness what is static is exact, however few the modes.
    few = reduce_layers(structure, {"layer": Stick(k=G)}, n_modes=3, interface_modes=1, **PLACES)
    x = np.linalg.solve(few.stiffness_at_rest(), few.row("forces", "end"))
    exact = response(structure, {}, 0.0, END)
    assert few.row("sensors", "end") @ x == pytest.approx(exact, rel=1e-4)


def test_linear_parameters_live_on():
    """Moduli and the layer's stretch changed in the reduced model, and gradients by differences."""
    structure = plates()
    law = Stick(k=G)
    model = reduce_layers(structure, {"layer": law}, n_modes=30, interface_modes=12)
    given = {"E": 6.5e10, "layer.E": 5e8, "s": 1.3, "m": 0.03}
    exact = solve_modes(structure, given, n_modes=10)
    assert np.abs(relative(solve_modes(model.at(given), n_modes=10), exact, 5)).max() < 3e-3
    assert model.at(given).total_mass() == pytest.approx(structure.total_mass(given), rel=1e-12)
    again = solve_modes(model, given, n_modes=10)
    assert again.frequencies_hz == pytest.approx(
        solve_modes(model.at(given), n_modes=10).frequencies_hz, rel=1e-12
    )
    modes = solve_modes(model.at(given), n_modes=10)
    slopes = modes.gradients(range(5, 9))
    for i, (name, value) in enumerate(model.values(given).items()):
        near = [
            solve_modes(model, {**given, name: value * f}, n_modes=10).eigenvalues[5:9]
            for f in (1 - 1e-4, 1 + 1e-4)
        ]
        difference = (near[1] - near[0]) / (2e-4 * value)
        assert slopes[:, i] * value == pytest.approx(
            difference * value, rel=1e-4, abs=1e-7 * modes.eigenvalues[8]
        ), name


# -- contacts --------------------------------------------------------------------------------------


@pytest.mark.parallel
@pytest.mark.parametrize("method", ["craig-bampton", "free-interface"])
def test_contacts_are_springs_where_their_laws_are(method):
    model, k_n, k = blocks(), 1e13, 1e11
    exact = solve_modes(sprung(model, k_n, k), n_modes=N)
    law = {"pads": Bond(k_n=k_n, k=k)}
    reduced = reduce_contacts(model, law, method=method, n_modes=30)
    found = relative(solve_modes(reduced, n_modes=N), exact, 6)
    # Of free-interface modes the frequencies are the full model's; of fixed ones an upper bound.
    assert -1e-8 < found.min() and found.max() < (5e-3 if method == "craig-bampton" else 1e-8)
    # An uncoupled law keeps the pairs closed, as springs without end do.
    exact = solve_modes(sprung(model, 1e17, k), n_modes=N)
    reduced = reduce_contacts(model, {"pads": Stick(k=k)}, method=method, n_modes=30)
    found = relative(solve_modes(reduced, n_modes=N), exact, 6)
    assert -1e-6 < found.min() and found.max() < (5e-3 if method == "craig-bampton" else 1e-6)


@pytest.mark.parallel
def test_methods_agree_and_converge_with_interface_modes():
    """Basis at one stiffness, law ten times softer; all, then few interface modes."""
    model = blocks()
    exact = solve_modes(sprung(model, 1e17, 1e10), n_modes=12)
    for method in ("craig-bampton", "free-interface"):
        worst = []
        for n in (3, 16, 54):
            law = {"pads": Stick(k=1e11)}
            reduced = reduce_contacts(model, law, method=method, n_modes=30, interface_modes=n)
            soft = reduced.with_laws(pads=Stick(k=1e10))
            worst.append(relative(solve_modes(soft, n_modes=12), exact, 6).max())
        assert worst[0] > 4 * worst[1] > 8 * worst[2]
        assert worst[1] < 5e-3 and worst[2] < 5e-4


@pytest.mark.parallel
def test_open_pairs_are_no_part_of_an_uncoupled_interface():
    model = blocks(degree=1)
    middle = model.interfaces[0].points[:, 0]
    conditions = {"pads": np.where(np.abs(middle - 0.1) > 0.06, SLIP, OPEN)}
    exact = solve_modes(LinearJoint(model, conditions), n_modes=N)
    reduced = reduce_contacts(LinearJoint(model, conditions), {"pads": Stick(k=0.0)}, n_modes=20)
    modes = solve_modes(reduced, n_modes=N)
    assert len(reduced.interfaces[0]) == np.sum(conditions["pads"] == SLIP)
    n_rigid = modes.n_rigid
    assert n_rigid == exact.n_rigid == 9  # the pads slide: two ways and a turn more
    assert np.abs(relative(modes, exact, n_rigid)).max() < 1e-3


@pytest.mark.parallel
def test_a_bolt_presses_the_contact_it_is_a_force_of():
    """Static response to the bolt's force: the pressure over the area is the force."""
    model = blocks(bolts=[WasherForce("bolt", "bottom", "top", 100.0)])
    reduced = reduce_contacts(model, {"pads": Bond(k_n=1e12, k=1e11)}, n_modes=12)
    K, M = reduced.stiffness_at_rest(), reduced.M
    x = np.linalg.solve(K + 1.0 * M, reduced.row("forces", "bolt"))
    points = reduced.interfaces[0]
    pressure = -1e12 * (points.rows[:, 0] @ x)
    assert points.weights @ pressure == pytest.approx(1.0, rel=1e-5)
    assert pressure == pytest.approx(np.full(len(points), 1 / 0.004), rel=0.05)


# -- damping and files -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def small():
    return reduce_layers(plates(), {"layer": Stick(k=G)}, n_modes=8, interface_modes=3, **PLACES)


def test_modal_damping_is_that_of_each_mode(small):
    """Ratios from the complex eigenvalues of the state matrix, not from the modes."""
    K, M, n = small.stiffness_at_rest(), small.M, small.n_dofs
    omega = np.sqrt(np.maximum(scipy.linalg.eigh(K, M, eigvals_only=True), 0.0))

    def ratios(C):
        inverse = np.linalg.inv(M)
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ C]])
        poles = np.linalg.eigvals(A)
        poles = poles[poles.imag > 0.5 * omega[5]]
        return (-poles.real / np.abs(poles))[np.argsort(np.abs(poles))]

    assert ratios(with_modal_damping(small, 0.02).C) == pytest.approx(np.full(n - 5, 0.02))
    listed = [0.0] * 5 + [0.01, 0.03]
    found = ratios(with_modal_damping(small, listed, rest=0.002).C)
    assert found == pytest.approx([0.01, 0.03] + [0.002] * (n - 7), rel=1e-6)
    found = ratios(with_rayleigh_damping(small, 3.0, 1e-6).C)
    assert found == pytest.approx(1.5 / omega[5:] + 5e-7 * omega[5:], rel=1e-6)


@pytest.mark.parallel
def test_a_file_gives_the_model_back_without_its_mesh(shared_tmp_path):
    structure = plates()
    law = Iwan(RichardAbbott(G, 1e5, 5e5, 2.5), 8)
    model = reduce_layers(structure, {"layer": law}, n_modes=8, interface_modes=3, **PLACES)
    model = with_modal_damping(model, 0.01)
    path = shared_tmp_path / "model.h5"
    model.write(path)
    # DOLFINx has an HDF5 of its own in the same process.
    with dolfinx.io.XDMFFile(structure.comm, shared_tmp_path / "mesh.xdmf", "w") as file:
        file.write_mesh(structure.mesh)
    again = read_interface_model(path)
    assert again.source is None and sorted(again.forces) == ["end", "tip"]
    for key in ("M", "K", "C"):
        assert np.array_equal(getattr(again, key), getattr(model, key))
    given = {"s": 1.2, "E": 6e10}
    both = [solve_modes(m, given, n_modes=8) for m in (model, again)]
    assert np.array_equal(both[0].eigenvalues, both[1].eigenvalues)
    sensors = Sensors([END[0], TIP[0]], [END[1], (0.0, 0.0, -1.0)])
    shapes = [m.at(sensors) for m in both]
    assert shapes[1] == pytest.approx(shapes[0], rel=1e-9, abs=1e-12)
    P = len(model.interfaces[0])
    stress = []
    for m in (model, again):
        law = m.interfaces[0].law.change(S_y=2e5)
        points = m.with_laws(layer=law).interfaces[0]
        stress.append(points.kernel.step(np.full((P, 2), 1e-3), None, law.values(P))[0])
    assert np.array_equal(*stress) and np.abs(stress[0]).max() > 1e5
    assert not list(shared_tmp_path.glob("*.part"))


def test_bad_files_are_named(small, tmp_path):
    path = tmp_path / "model.h5"
    small.write(path)
    whole = path.read_bytes()
    with pytest.raises(InputError, match="there is no such file"):
        read_interface_model(tmp_path / "none.h5")
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"model.h5: is damaged"):
        read_interface_model(path)
    path.write_bytes(b"K = 1")
    with pytest.raises(InputError, match="no HDF5 file"):
        read_interface_model(path)
    for change, message in (
        (lambda f: f.attrs.modify("version", 99), "has version 99"),
        (lambda f: f.attrs.modify("format", "else"), "is no reduced model"),
        (lambda f: f["model"].__delitem__("0"), "is damaged"),
    ):
        path.write_bytes(whole)
        with h5py.File(path, "r+") as file:
            change(file)
        with pytest.raises(InputError, match=message):
            read_interface_model(path)
    path.write_bytes(whole)
    with h5py.File(path, "r+") as file:
        file.visititems(
            lambda _, item: (
                None
                if not item.attrs.get("kind", "").startswith("law")
                else item.attrs.modify("kind", "law elsewhere.Own")
            )
        )
    with pytest.raises(InputError, match=r"elsewhere.Own is not known here"):
        read_interface_model(path)
    with pytest.raises(InputError, match="no folder"):
        small.write(tmp_path / "none" / "model.h5")


def test_bad_input_is_named(small):
    structure, law = plates(), Stick(k=G)
    for laws, more, message in (
        ({}, {}, "expected a law for one of the layers layer"),
        ({"plates": law}, {}, "'plates' is no thin layer; expected: layer"),
        ({"layer": law}, {"interface_modes": 1000}, "interface_modes = 1000: expected"),
        ({"layer": law}, {"tolerance": 1.0}, "tolerance = 1.0"),
        ({"layer": law}, {"forces": {"f": ((9.0, 0, 0), (0, 0, 1))}}, "force at .* is outside"),
        ({"layer": law}, {"sensors": {"s": (0.1, 0.2)}}, "sensors.'s'.*expected .position"),
        ({"layer": law}, {"forces": {"f": ((0.1, 0, 0), (0, 0, 0))}}, "direction not zero"),
    ):
        with pytest.raises(InputError, match=message):
            reduce_layers(structure, laws, **more)
    with pytest.raises(InputError, match="expected uncoupled or constrained"):
        reduce_layers(plates(law="isotropic"), {"layer": law})
    with pytest.raises(InputError, match="expected a law that is uncoupled"):
        small.with_laws(layer=Bond(k_n=E, k=G))
    with pytest.raises(InputError, match="expected damping ratios >= 0"):
        with_modal_damping(small, [-0.1])
    with pytest.raises(InputError, match="'F' does not exist"):
        small.at({"F": 1.0})
    model = blocks(degree=1)
    for laws, more, message in (
        ({"pad": law}, {}, "there is no contact 'pad'; expected: pads"),
        ({"pads": law}, {"method": "guyan"}, "'craig-bampton' or 'free-interface'"),
        ({"pads": law}, {"interface_modes": 1000}, "expected 1 to 54"),
    ):
        with pytest.raises(InputError, match=message):
            reduce_contacts(model, laws, **more)
    apart = LinearJoint(model, {"pads": np.full(len(model.interfaces[0]), OPEN)})
    with pytest.raises(InputError, match="all its pairs are open"):
        reduce_contacts(apart, {"pads": law})
