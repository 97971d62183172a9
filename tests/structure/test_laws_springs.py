"""Joints by their stiffness per area, against layers with moduli."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.meshes import lap_plates
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Parameter, Structure, interface, joint, part

LAYER, ZONES = 0.5e-3, ("joint_near", "joint_away")


@pytest.mark.parallel
def test_springs_are_moduli_over_the_thickness():
    """The same modes as of an uncoupled layer, and slopes by k are h times those by E and G."""
    tagged = lap_plates(MPI.COMM_WORLD, element_size=0.02, layer=LAYER)
    plates = [name for name in tagged.cell_names if name not in ZONES]
    metal = part("plates", tuple(plates), E=69e9, nu=0.28, rho=2750.0)
    k = {"k_n": 1.7e12, "k_t": 6.8e11}
    springs = interface("lap", ZONES, k_n="k_n", k_t="k_t", meshed=LAYER)
    layer = joint("lap", ZONES, E="E", G="G")
    moduli = [Parameter(name, value * LAYER) for name, value in zip("EG", k.values(), strict=True)]
    found = solve_modes(
        Structure(tagged, [metal, springs], [Parameter(*item) for item in k.items()], degree=1),
        n_modes=10,
    )
    expected = solve_modes(Structure(tagged, [metal, layer], moduli, degree=1), n_modes=10)
    assert found.eigenvalues[6:] == pytest.approx(expected.eigenvalues[6:], rel=1e-9)
    by_k, by_modulus = (modes.gradients([6, 7, 8]) for modes in (found, expected))
    assert np.all(by_k > 0)
    assert by_k == pytest.approx(LAYER * by_modulus, rel=1e-6)


def test_refusals():
    with pytest.raises(InputError, match=r"lap.meshed = 0.*above 0 m"):
        interface("lap", "near", k_n=1e12, k_t=1e12, meshed=0.0)
    with pytest.raises(InputError, match="lap.k_t = -1 is out of range: expected k_t >= 0"):
        interface("lap", "near", k_n=1e12, k_t=-1.0, meshed=1e-6)
