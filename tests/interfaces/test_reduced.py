"""The reduced model: damping, files, and what it refuses."""

from __future__ import annotations

import dolfinx.io
import h5py
import numpy as np
import pytest
import scipy.linalg
from layered_plates import END, PLACES, TIP, Bond, E, G, Stick, blocks, plates

from fenics_joints.errors import InputError
from fenics_joints.files import sealed
from fenics_joints.interfaces import (
    read_interface_model,
    reduce_contacts,
    reduce_layers,
    with_modal_damping,
    with_rayleigh_damping,
)
from fenics_joints.joint_laws import Iwan, RichardAbbott
from fenics_joints.modal import solve_modes
from fenics_joints.preload import OPEN
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.structure import Sensors


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


def unknown_law(file):
    """Let the file name a law that is not there."""
    laws = []
    file.visititems(lambda _, item: laws.append(item) if "kind" in item.attrs else None)
    for item in laws:
        if item.attrs["kind"].startswith("law"):
            item.attrs["kind"] = "law elsewhere.Own"


def test_bad_files_are_named(small, tmp_path):
    path = tmp_path / "model.h5"
    small.write(path)
    whole = path.read_bytes()
    with pytest.raises(InputError, match="there is no such file"):
        read_interface_model(tmp_path / "none.h5")
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"model.h5: is damaged"):
        read_interface_model(path)
    for change, message in (
        (lambda f: f.attrs.modify("version", 99), "has version 99"),
        (lambda f: f.attrs.modify("format", "else"), "is no interface model"),
        (lambda f: f["model"].__delitem__("0"), "holds no such model"),
        (unknown_law, r"elsewhere.Own is not known here"),
    ):
        with sealed(path) as part:
            part.write_bytes(whole)
            with h5py.File(part, "r+") as file:
                change(file)
        with pytest.raises(InputError, match=message):
            read_interface_model(path)


def at(*place):
    return {"forces": {"f": place}}


def test_bad_input_is_named(small):
    structure, law = plates(), Stick(k=G)
    model = blocks(degree=1)
    pads, open_pads = LinearJoint(model), {"pads": np.full(len(model.interfaces[0]), OPEN)}
    ours, own = {"layer": law}, {"pads": law}
    for make, source, laws, more, message in (
        (reduce_layers, structure, {}, {}, "expected a law for one of the layers layer"),
        (reduce_layers, structure, {"plates": law}, {}, "is no thin layer; expected: layer"),
        (reduce_layers, structure, ours, {"interface_modes": 1000}, "interface_modes = 1000: exp"),
        (reduce_layers, structure, ours, {"tolerance": 1.0}, "tolerance = 1.0"),
        (reduce_layers, structure, ours, at((9.0, 0, 0), (0, 0, 1)), "force at .* is outside"),
        (reduce_layers, structure, ours, {"sensors": {"s": (0.1, 0.2)}}, "'s'.*expected .position"),
        (reduce_layers, structure, ours, at((0.1, 0, 0), (0, 0, 0)), "direction not zero"),
        (reduce_layers, plates(law="isotropic"), ours, {}, "expected uncoupled or constrained"),
        (reduce_contacts, pads, {"pad": law}, {}, "there is no contact 'pad'; expected: pads"),
        (reduce_contacts, pads, own, {"method": "guyan"}, "'craig-bampton' or 'free-interface'"),
        (reduce_contacts, pads, own, {"interface_modes": 1000}, "expected 1 to 54"),
        (reduce_contacts, LinearJoint(model, open_pads), own, {}, "all its pairs are open"),
    ):
        with pytest.raises(InputError, match=message):
            make(source, laws, **more)
    with pytest.raises(InputError, match="expected a law that is uncoupled"):
        small.with_laws(layer=Bond(k_n=E, k=G))
    with pytest.raises(InputError, match=r"ratios = .-0.1.: expected numbers of at least 0"):
        with_modal_damping(small, [-0.1])
