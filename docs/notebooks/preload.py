# # Contact under a bolt's preload
#
# What `fenics-joints preload` does, on the half section of two plates under one bolt of 25 kN.

# +
from mpi4py import MPI

from fenics_joints.meshes import bolted_plates_section
from fenics_joints.preload import Contact, PreloadModel, WasherForce, solve_preload
from fenics_joints.structure import Structure, part

plates = bolted_plates_section(MPI.COMM_WORLD, thickness=(0.02, 0.02))
steel = part("plates", ("plate_1", "plate_2"), E=200e9, nu=0.3, rho=7850)
structure = Structure(plates, [steel], axisymmetric=True)
joint = Contact("joint", "interface_lower", "interface_upper", friction=0.15)
bolt = WasherForce("bolt", "washer_1", "washer_2", force=25e3)
found = solve_preload(PreloadModel(structure, [joint], [bolt]))
found
# -

# The pressures carry the bolt's force; the contact radius is where they fall to 1 MPa.

# +
state = found["joint"]
print(f"{state.normal_force:.2f} N, 1 MPa at {1e3 * state.radius(1e6):.2f} mm")
assert abs(state.normal_force / 25e3 - 1) < 1e-6
# -

# The picture of the command's page; of a model in space there is also `pressure_map`, and
# `state.to_pyvista()` for pyvista.

# +
# %matplotlib inline
from fenics_joints.report import pressure_profile

pressure_profile(state)
