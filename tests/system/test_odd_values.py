"""Every public constructor and function refuses values that make no sense, by the argument's name.

`odd_calls.CALLS` has a call that works for each of them; each argument in turn gets values that are
odd for its kind, which have to end in an `InputError` unless the table says that they are taken.
"""

from __future__ import annotations

import pytest
from mpi4py import MPI
from odd_calls import CALLS, plates
from odd_values import TEXT, not_refused

from fenics_joints import harmonic, interfaces, measurements, modal, reduction
from fenics_joints.errors import InputError
from fenics_joints.meshes import lap_plates
from fenics_joints.structure import Structure, joint, part


@pytest.mark.parametrize("rooms", CALLS)
def test_odd_values_are_refused(rooms):
    wrong = not_refused(CALLS[rooms]())
    assert not wrong, "\n".join(wrong)


READERS_OF = (measurements.read_curves, harmonic.read_loops)
READERS = (
    measurements.read_frfs,
    measurements.read_shapes,
    measurements.read_table,
    measurements.read_test_data,
    reduction.read_array_model,
    interfaces.read_interface_model,
)


@pytest.mark.parametrize("read", [*READERS, *READERS_OF])
def test_what_is_no_file_is_refused(read):
    more = ("displacement",) if read in READERS_OF else ()
    for value in (None, 1.0, "", "nowhere.csv", "/", "a" * 5000, "a\0b"):
        with pytest.raises(InputError):
            read(value, *more)
    for response in TEXT.values() if more else ():
        with pytest.raises(InputError):
            read("nowhere.csv", response)


def test_option_that_no_solver_reads_is_said():
    with pytest.warns(UserWarning, match="eps_bogus"):
        modal.solve_modes(plates(), n_modes=8, petsc_options={"eps_bogus": 1})


def test_structure_without_mass_is_refused():
    weightless = [part("plates", ("plate_1", "plate_2"), E=2e11, nu=0.3, rho=0.0)]
    layers = joint("layer", ("joint_near", "joint_away"), E=1e9, G=4e8)
    tagged = lap_plates(MPI.COMM_SELF, element_size=0.04, n_thickness=1)
    with pytest.raises(InputError, match="mass"):
        modal.solve_modes(Structure(tagged, [*weightless, layers], degree=1), n_modes=8)
