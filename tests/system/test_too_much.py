"""Numbers and lists that are beyond any structure and any machine."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.database import grid
from fenics_joints.database.analysis import bolted_plates_radius
from fenics_joints.errors import InputError
from fenics_joints.joint_laws import Iwan, RichardAbbott, iwan_sliders
from fenics_joints.meshes import box, engraving_machine, lap_plates
from fenics_joints.structure import PointMass, Spring, Structure, part

POINTS = ", ".join(['["10 mm", "40 mm"]'] * 20_000)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('E = "69 GPa"', 'E = "1e300 Pa"', ["parts.plates.E", "1e300", "at most 1e+20 Pa"]),
        ('rho = "2750 kg/m3"', "rho = 1e-300", ["parts.plates.rho", "at least 1e-06 kg/m3"]),
        ('thickness = "8 mm"', 'thickness = "1e300 m"', ["mesh.thickness", "at most 1e+06 m"]),
        ('thickness = "8 mm"', 'thickness = "1e-300 m"', ["mesh.thickness", "at least 1e-09 m"]),
        ('thickness = "8 mm"', 'thickness = "1 m**9**9**9"', ["mesh.thickness", "a length"]),
        ('element_size = "20 mm"', "n_length = 10000000000", ["n_length", "less than or equal"]),
        ('mass = "160 g"', "mass = -1", ["attached.bolts.mass", "above 0 kg"]),
        ('points = [["10 mm", "40 mm"]]', f"points = [{POINTS}]", ["20003 points", "at most"]),
        ("n_modes = 14", "n_modes = 100000", ["diagnose.n_modes", "10000"]),
        ('frequencies = "frequencies.csv"', 'frequencies = ""', ["the name of a file"]),
        ('frequencies = "frequencies.csv"', f'frequencies = "{"a" * 5000}"', ["no such file"]),
        ('frequencies = "frequencies.csv"', 'frequencies = "a\\u0000b"', ["U+0000"]),
    ],
)
def test_mistakes(tmp_path, write_case, old, new, said):
    start = time.perf_counter()
    with pytest.raises(InputError) as error:
        load_case(write_case(tmp_path, (old, new)))
    assert time.perf_counter() - start < 5.0 and len(str(error.value)) < 1000
    for fragment in said:
        assert fragment in str(error.value)


def test_a_byte_order_mark_is_read(tmp_path, write_case):
    """Windows' editors write it; the message once was "Invalid statement"."""
    write_case(tmp_path)
    file = tmp_path / "case.toml"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert load_case(tmp_path).title == "Lap plates"


def test_point_masses_and_springs_are_counted_once():
    """Names were once compared pairwise: 100,000 took minutes."""
    body = box(MPI.COMM_SELF, (1.0, 1.0, 1.0), (1, 1, 1))
    parts = [part("body", "body", E=1e9, nu=0.3, rho=1e3)]
    start = time.perf_counter()
    masses = [PointMass(f"m{i}", 1.0, (0.5, 0.5, 0.5)) for i in range(20_000)]
    with pytest.raises(InputError, match="masses: 20000 of them, expected at most 10000"):
        Structure(body, parts, masses=masses)
    springs = [Spring(f"k{i}", 1.0, (0.5, 0.5, 0.5), (1, 0, 0)) for i in range(20_000)]
    with pytest.raises(InputError, match="springs: 20000 of them, expected at most 10000"):
        Structure(body, parts, springs=springs)
    Structure(body, parts, masses=masses[:10_000])
    assert time.perf_counter() - start < 20.0


@pytest.mark.parametrize("make", [Iwan, iwan_sliders])
def test_sliders(make):
    backbone = RichardAbbott(E_e=168e6, E_p=1e5, S_y=5.7e5, n=2.5)
    with pytest.raises(InputError, match=r"n_sliders = 1000000000: .* at most 1000"):
        make(backbone, 10**9)


@pytest.mark.parametrize("thickness", [1e300, 1e-300])
def test_builders_make_no_mesh_of_such_a_size(thickness):
    """The message once was that the eigensolver's shift is nan."""
    with pytest.raises(InputError, match="thickness is 1e.*from 1e-12 to 1e9 m"):
        lap_plates(MPI.COMM_SELF, thickness=thickness)


def test_sweeps_of_a_database():
    """Of a million million samples, and of one with cells of a nanometre."""
    with pytest.raises(InputError, match="1000000000000 samples: expected at most"):
        grid(["M12"], range(10**6), range(10**6))
    sample = grid(["M12"], [25e3], [0.02])[0]
    with pytest.raises(InputError, match="size = 1e-09: expected at least"):
        bolted_plates_radius(sample, size=1e-9)


def test_builders_compare_no_million_bolts():
    """Each bolt is compared with each, and each row is a box that others are cut by."""
    with pytest.raises(InputError, match="bolts .*at most 1000"):
        lap_plates(MPI.COMM_SELF, bolts=[(0.16, 0.04)] * 1001)
    with pytest.raises(InputError, match="bolts .*from 3 to 100"):
        engraving_machine(MPI.COMM_SELF, bolts=(10**9, 3))
    with pytest.raises(InputError, match="ribs .*at most 100"):
        engraving_machine(MPI.COMM_SELF, ribs=10**9)
