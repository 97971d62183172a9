"""Modes identified from measured functions, against those that the functions were made of."""

from __future__ import annotations

import measured_world as world
import numpy as np
import pytest
import scipy.io
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.errors import InputError
from fenics_joints.measurements import MeasuredFRFs, identify_modes
from fenics_joints.modal import solve_modes
from fenics_joints.report.stabilisation import label_levels, write_stabilisation

pytest.importorskip("sdypy.EMA")

POINTS = 1e-3 * np.array(list(world.NODES.values()))
DIRECTIONS = np.eye(3)[[2, 1, 2]]


def _measured(f, H, responses, references, **more):
    return MeasuredFRFs(f, H, "accelerance", *responses, *references, **more)


def _noisy(H, noise, seed):
    """With noise of a share of the functions' mean magnitude."""
    noise, rng = noise * np.abs(H).mean(axis=0) / np.sqrt(2), np.random.default_rng(seed)
    return H + noise * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))


def _frfs(references, noise=0.0, seed=0, frequencies=world.FREQUENCIES, kind="accelerance"):
    """Functions with noise; nothing measured at [2, 0]."""
    H = _noisy(world.accelerance(frequencies)[:, :, references], noise, seed)
    if len(references) > 1:
        H[:, 2, 0] = np.nan
    forces = POINTS[references], DIRECTIONS[references]
    return _measured(frequencies, H, (POINTS, DIRECTIONS), forces).converted(kind)


def _against(found, true):
    """True shapes with the signs of those that were found."""
    return true * np.sign((true * found.shapes).sum(axis=0))


def _off(found, f, zeta, shapes):
    """Errors of all modes in the stated deviations: frequency, damping, shape."""
    return np.vstack(
        [
            (found.frequencies_hz - f) / found.frequencies_sd,
            (found.damping - zeta) / found.damping_sd,
            (found.shapes - _against(found, shapes)) / found.shapes_sd,
        ]
    )


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_known_modes(kind):
    """0.1 % of a frequency and 5 % of a damping are asked for; noise 3 %, in two ways better."""
    f_true, phi = world.modes()
    found = identify_modes(_frfs([0, 2], 0.03, kind=kind))
    assert found.frequencies_hz == pytest.approx(f_true, rel=1e-4)
    assert found.damping == pytest.approx(world.ZETA, rel=5e-3)
    assert found.mass_normalised and (found.phase_collinearity > 0.999).all()
    assert np.abs(found.shapes - _against(found, phi)).max() < 0.01


def test_roving_hammer():
    """One sensor and three places of the force give the same shapes as the transposed test."""
    H, places = world.accelerance()[:, 2:, :], (POINTS, DIRECTIONS)
    roving = _measured(
        world.FREQUENCIES,
        H,
        (POINTS[2:], DIRECTIONS[2:]),
        places,
        reference_names=("1:+z", "2:+y", "7:+z"),
        coherence=np.full(H.shape, 0.9),
    )
    found = identify_modes(roving)
    assert found.mass_normalised and found.frfs.response_names == roving.reference_names
    assert np.abs(found.shapes - _against(found, world.modes()[1])).max() < 1e-4
    assert found.test_data().sensors.points == pytest.approx(POINTS)


def test_modes_closer_than_their_half_width():
    """0.15 % apart, with damping of 0.5 % and noise of 2 %, by two references."""
    f_true, zeta = np.array([100.0, 200.0, 200.3]), 0.005
    x = np.linspace(0, 1, 6)
    phi = np.array([np.cos(r * np.pi * x + 0.3 * (r - 1)) for r in (1, 2, 3)]).T
    f = np.arange(50.0, 401.0, 0.125)
    s, w = 2j * np.pi * f[:, None], 2 * np.pi * f_true
    H = np.einsum("ir,jr,nr->nij", phi, phi[[0, 3]], s**2 / (s**2 + 2 * zeta * w * s + w**2))
    rng = np.random.default_rng(0)
    H *= 1 + 0.02 / np.sqrt(2) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    points, along = np.outer(x, [1.0, 0, 0]), np.tile([0, 0, 1.0], (6, 1))
    found = identify_modes(_measured(f, H, (points, along), (points[[0, 3]], along[[0, 3]])))
    assert found.frequencies_hz == pytest.approx(f_true, rel=1e-4)
    assert np.abs(found.shapes - _against(found, phi)).max() < 0.05


def test_labels_of_close_modes_stand_below_each_other():
    assert label_levels(np.array([10.0, 50.0, 50.5, 51.0, 53.0]), 1.8) == [0, 0, 1, 2, 0]


def test_stated_deviations():
    """Errors over 20 tests have the deviations that each of them states."""
    f_true, phi = world.modes()
    errors = [
        _off(
            identify_modes(_frfs([0, 2], 0.08, s), order=12, near=f_true + 1),
            f_true,
            world.ZETA,
            phi,
        )
        for s in range(20)
    ]
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms > 0.6).all() and (rms < 1.5).all()


@pytest.mark.parallel
def test_narrow_band_and_picture(shared_tmp_path):
    frfs = _frfs([0], 0.01, frequencies=np.arange(200.0, 290.0, 0.25))
    found = identify_modes(frfs, near=[251])
    assert found.frequencies_hz == pytest.approx(world.modes()[0][[1]], rel=1e-3)
    assert found.damping == pytest.approx(world.ZETA[[1]], rel=0.05)
    comm, picture = MPI.COMM_WORLD, shared_tmp_path / "a.png"
    write_stabilisation(found, picture, comm)
    assert all((f == found.frequencies_hz).all() for f in comm.allgather(found.frequencies_hz))
    assert picture.read_bytes()[:4] == b"\x89PNG"


def test_what_is_refused():
    band = _frfs([0], 0.01, frequencies=np.arange(200.0, 290.0, 0.25))
    dead, uneven = _frfs([0]), _frfs([0], frequencies=np.geomspace(60, 300, 400))
    dead.values[:, 1] = 0
    for frfs, given, words in (
        (band, {"near": [220]}, "near = 220 Hz: expected a stable pole .* are at 251.* Hz"),
        (band, {"order": 100}, "order = 100: expected at most 90"),
        (uneven, {}, "evenly spaced lines"),
        (dead, {}, "response 2 by reference 1 is zero"),
        (_frfs([0], 1e3), {}, "no pole"),
    ):
        with pytest.raises(InputError, match=words):
            identify_modes(frfs, **given)


SIX = 1.5 * np.random.default_rng(5).normal(size=(6, 4))  # mass-normalised shapes at six sensors
CLOSE, SIX_ZETA = np.array([62, 118, 121.5, 260]), np.array([0.008, 0.006, 0.007, 0.01])
PLACES, UP = np.outer(np.linspace(0, 0.4, 6), [1, 0, 0]), np.tile([0, 0, 1.0], (6, 1))


def _six(references, noise=0.0, seed=0, fn=CLOSE, shift=(0,) * 6, decay=0.0, without=()):
    """Functions of four modes; of the sensor i all frequencies are 1 + shift[i] times ``fn``."""
    f, references = np.arange(20, 400.01, 0.25), list(references)
    s = (2j * np.pi * f + decay)[:, None, None]
    w = 2 * np.pi * np.outer(1 + np.asarray(shift), fn)
    H = np.einsum(
        "nir,ir,jr->nij", s**2 / (s**2 + 2 * SIX_ZETA * w * s + w**2), SIX, SIX[references]
    )
    H = _noisy(H, noise, seed)
    for rows, column in without:
        H[:, rows, column] = np.nan
    return _measured(f, H, (PLACES, UP), (PLACES[references], UP[references]))


def test_close_modes_and_their_deviations():
    """A mode 3 % above another, beside which LSCF loses it at some seeds."""
    errors = []
    for seed in range(6):
        found = identify_modes(_six([0, 2], 0.02, seed))
        assert len(found.damping) == 4 and not found.notes
        errors.append(_off(found, CLOSE, SIX_ZETA, SIX))
    errors = np.array(errors)
    assert 0.8 < (np.abs(errors) < 1.645).mean() < 0.96  # 90 % are right
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.4


MOVED = [
    ((0, 5), [(slice(4, 6), 0), (slice(0, 3), 1)]),  # sensor 4 stayed
    ((0, 1), [(slice(3, 6), 0), (slice(0, 3), 1)]),  # the force came to where sensor 2 was
]


@pytest.mark.parametrize(("references", "without"), MOVED)
def test_what_was_moved_is_linked(references, without):
    found = identify_modes(_six(references, 0.001, without=without))
    assert found.mass_normalised
    off = np.abs(found.shapes - _against(found, SIX))
    assert off.max() < 0.002 and (off < 4 * found.shapes_sd).all()


def test_what_nothing_links_is_refused():
    """Both halves have a driving point, but nothing says the sign of one by the other."""
    apart = _six([0, 5], without=[(slice(3, 6), 0), (slice(0, 3), 1)])
    with pytest.raises(InputError) as raised:
        identify_modes(apart)
    for name in ("response 1, response 2, response 3", "response 4", "reference 2"):
        assert name in str(raised.value)


def test_two_modes_at_one_frequency():
    found = identify_modes(_six([0, 2], 0.005, fn=np.array([62, 118, 118, 260])))
    assert found.frequencies_hz == pytest.approx([62, 118, 118, 260], rel=2e-4)
    assert len(found.notes) and all("118" in note for note in found.notes)
    # What both shapes span is what the true ones span.
    q = np.linalg.qr(found.shapes[:, 1:3])[0]
    assert np.abs(SIX[:, 1:3] - q @ (q.T @ SIX[:, 1:3])).max() < 0.03


def test_poles_that_differ_from_sensor_to_sensor():
    """By up to 1 %, as one accelerometer after the other makes them."""
    shift = [0, -0.002, -0.01, -0.004, -0.008, -0.001]
    found = identify_modes(_six([0], 0.005, shift=shift))
    assert found.frequencies_hz == pytest.approx(CLOSE, rel=0.01)
    assert (np.abs(found.frequencies_hz - CLOSE) < 2 * found.frequencies_sd).all()
    assert found.damping == pytest.approx([0.008, 0.006, 0.007, 0.01], rel=0.02)
    assert "response 3" in found.notes[0] and "response 1" in found.notes[0]
    assert found.test_data().notes == found.notes


def test_what_is_left_is_said():
    """Sensors' scales that changed by some per cent between the forces: no mode, but no noise."""
    frfs = _six([0, 2], 0.005)
    frfs.values[:] *= 1 + 0.03 * np.random.default_rng(0).normal(size=(6, 2))
    found = identify_modes(frfs)
    assert found.frequencies_hz == pytest.approx(CLOSE, rel=1e-4) and found.notes
    # Of rank one again, nothing is.
    assert not identify_modes(frfs.select(references=["reference 1"])).notes


def test_exponential_window():
    """Functions of windowed responses are those at s + 1 / time."""
    found = identify_modes(_six([0, 2], 0.005, decay=1 / 0.25), exponential_window=0.25)
    assert found.damping == pytest.approx(SIX_ZETA, rel=2e-3)
    found = identify_modes(_six([0, 2], 0.005, decay=4))
    assert found.damping[0] == pytest.approx(0.0183, rel=3e-3)
    with pytest.raises(InputError, match="exponential_window = 0.1 s"):
        identify_modes(_six([0, 2], 0.005), exponential_window=0.1)


IDENTIFIED = [
    ('frequencies = "frequencies.csv"\n', ""),
    ('damping = "damping.csv"\n', ""),
    ('condition = "torque"\n', ""),
    ('resolution = ["12.5 Hz", "12.5 Hz", "0 Hz", "0 Hz"]\n', ""),
    ('[test.validation]\nfrequencies = "frequencies_28Nm.csv"\n', ""),
    ("at = 20\n", ""),
    ('["near.E", "near.G", "away.E", "away.G"]', '["near.E"]'),
    ('"near.E" = "3 GPa"', '"near.E" = "300 MPa"'),
    ("hold_out = [4, 8, 12]\n", ""),
]
SEES = """[test.sees]
along = "x"
positions = ["10 mm", "60 mm", "110 mm", "210 mm", "310 mm"]
at = { y = "40 mm", z = ["8 mm", "8 mm", "8 mm", "16.5 mm", "16.5 mm"] }
direction = [0, 0, 1]
"""


def _measured_plates(case, path):
    """A file of accelerances of the case's own model; frequencies, Hz, and shapes of its modes."""
    sensors = case.sensors()
    modes = solve_modes(build_structure(case, MPI.COMM_SELF), n_modes=16)
    f, phi = modes.frequencies_hz, modes.at(sensors)
    lines = np.arange(150.0, 3600.0, 2.5)
    s, w = 2j * np.pi * lines[:, None], 2 * np.pi * f
    H = np.einsum("ir,nr,r->ni", phi, s**2 / (s**2 + 0.01 * w * s + w**2), phi[0])
    rng = np.random.default_rng(1)
    H += 0.01 * np.abs(H).mean() * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    scipy.io.savemat(
        path,
        dict(
            frequency=lines,
            frf=H,
            response_points=1e3 * sensors.points,
            length_unit="mm",
            response_directions=sensors.directions,
            reference_points=1e3 * sensors.points[:1],
            reference_directions=sensors.directions[:1],
        ),
    )
    seen = (modes.visibility(sensors) > 0.1) & (f > 150) & (f < 3600)
    return f[seen], phi[:, seen]


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="writes a case in a folder")
def test_functions_in_a_case(write_case, tmp_path):
    """Functions in place of frequencies: the test that `update` and `diagnose` then see."""
    f, phi = _measured_plates(load_case(write_case(tmp_path)), tmp_path / "frfs.mat")
    frfs = '[test.frfs]\nfiles = "frfs.mat"\nunits = "m/s2/N"\nat = 20\n'
    edits = [*IDENTIFIED, (SEES, frfs + "[test.frfs.identify]\n")]
    case = load_case(write_case(tmp_path, *edits))
    data = case.measurements()
    assert data.mode_names == ("bending 1", "bending 2", "bending 3", "bending 4")
    assert data.frequencies_hz[0] == pytest.approx(f, rel=1e-4)
    assert data.damping[0] == pytest.approx(0.005, rel=0.02)
    assert (data.noise >= 0.003).all() and data.conditions == [20.0]
    assert np.abs(data.shapes - _against(data, phi)).max() < 0.01  # of 2.4
    assert (data.sensors.directions == case.sensors().directions).all() and len(data.sensors) == 5
    assert case.frfs().band(2000, 3000).kind == "accelerance"

    for others, text, said in [
        (IDENTIFIED, 'frfs = "frfs.mat"\n', "test.frfs: .*frfs.mat: .*the unit is not known"),
        (IDENTIFIED, 'frfs = { fles = "frfs.mat" }\n', "frfs.fles.* did you mean 'files'"),
        ([], SEES + frfs.replace("20", "21"), "test.frfs: torque = 21 was not measured"),
        ([], SEES + edits[-1][1], "frfs.identify: expected it only without frequencies"),
        ([], SEES + frfs + 'band = ["4 kHz", "5 kHz"]\n', "band = .4000, 5000. Hz: expected"),
    ]:
        with pytest.raises(InputError, match=said):
            load_case(write_case(tmp_path, *others, (SEES, text)))
    case = load_case(write_case(tmp_path, (SEES, SEES + frfs + 'band = ["200 Hz", "1 kHz"]\n')))
    assert case.frfs().frequencies_hz[-1] == 1000 and len(case.measurements()) == 11
