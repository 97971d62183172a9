"""Functions from time records, against those of the oscillator that made them."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
import scipy.io

from fenics_joints.errors import InputError
from fenics_joints.measurements import TimeSettings, frfs_from_time, read_frfs

RATE, N = 1024.0, 1 << 16


def system():
    """Two masses of 1 kg: receptances by two forces, and the same in discrete time."""
    K = np.array([[3e5, -1e5], [-1e5, 2e5]])
    C = 0.5 * np.eye(2) + 2e-5 * K
    return K, C


def exact(hz: np.ndarray) -> np.ndarray:
    K, C = system()
    w = 2 * np.pi * hz[:, None, None]
    return np.linalg.inv(K - w**2 * np.eye(2) + 1j * w * C)


def moved(forces: np.ndarray) -> np.ndarray:
    """Displacements under forces (n, k) that are periodic in the record."""
    hz = np.fft.rfftfreq(len(forces), 1 / RATE)
    spectrum = np.fft.rfft(forces, axis=0)
    return np.fft.irfft(
        np.einsum("nrf,nf->nr", exact(hz)[:, :, : forces.shape[1]], spectrum), len(forces), axis=0
    )


def noise(shape, seed=0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


@pytest.mark.parametrize(
    ("how", "on_force", "on_motion"), [("H1", 0.0, 0.1), ("H2", 0.3, 0.0), ("Hv", 0.0, 0.0)]
)
def test_each_estimator_is_free_of_bias_by_its_own_noise(how, on_force, on_motion):
    f = noise((N, 1))
    x = moved(f)
    size = np.abs(x).std()
    found = frfs_from_time(
        RATE,
        f + on_force * noise(f.shape, 1),
        x + on_motion * size * noise(x.shape, 2),
        TimeSettings(block=4.0, estimator=how),
    )
    band = (found.frequencies_hz > 40) & (found.frequencies_hz < 110)
    wanted = exact(found.frequencies_hz)[:, :, :1]
    error = np.abs(found.values / wanted - 1)[band]
    assert np.median(error) < 0.05
    # The mean of the ratio shows a bias, which one of noise on the other side has.
    assert np.mean((found.values / wanted)[band].real) == pytest.approx(1, abs=0.02)
    assert found.averages == 31 and found.coherence.shape == (len(wanted), 2)
    if on_force:
        # Coherence of a force with noise: 1 / (1 + 0.3^2).
        assert np.median(found.coherence[band]) == pytest.approx(1 / 1.09, abs=0.03)


def test_two_forces_together():
    f = noise((N, 2))
    found = frfs_from_time(RATE, f, moved(f), TimeSettings(block=4.0))
    band = (found.frequencies_hz > 40) & (found.frequencies_hz < 110)
    error = np.abs(found.values - exact(found.frequencies_hz))[band]
    assert np.median(error) < 0.05 * np.median(np.abs(found.values[band]))
    assert np.median(found.coherence[band]) > 0.97
    with pytest.raises(InputError, match="not independent"):
        frfs_from_time(RATE, f[:, [0, 0]], moved(f), TimeSettings(block=4.0))


def hits(double: bool = False) -> np.ndarray:
    f = np.zeros((N, 1))
    for k in range(6):
        at = 1000 + k * 10000
        f[at : at + 3, 0] += [50, 100, 50]
        if double and k == 2:
            f[at + 300 : at + 303, 0] += [30, 60, 30]
    return f


def test_hits_of_a_hammer():
    """A block from each hit; a double hit is left out; an exponential window is 1 / (2 pi f t)."""
    f = hits(double=True)
    x = moved(f)
    found = frfs_from_time(RATE, f, x, TimeSettings(window="hammer", block=8.0))
    assert found.averages == 5 and "1 double hits were left out" in found.notes[1]
    band = (found.frequencies_hz > 5) & (found.frequencies_hz < 110)
    wanted = exact(found.frequencies_hz)[:, :, :1]
    assert np.abs(found.values - wanted)[band].max() < 0.02 * np.abs(wanted[band]).max()
    assert found.coherence[band].min() > 0.99
    # An amplifier's offset changes no function.
    shown = frfs_from_time(RATE, f + 0.05 * f.max(), x, TimeSettings(window="hammer", block=8.0))
    assert np.abs(shown.values - found.values)[band].max() < 1e-9 * np.abs(wanted[band]).max()
    windowed = frfs_from_time(
        RATE, hits(), moved(hits()), TimeSettings(window="hammer", block=8.0, exponential=0.5)
    )
    # A window that falls to 1/e in t moves each pole by 1/t to the left.
    s = 2j * np.pi * windowed.frequencies_hz[:, None, None] + 1 / 0.5
    K, C = system()
    shifted = np.linalg.inv(K + s**2 * np.eye(2) + s * C)[:, :, :1]
    assert np.abs(windowed.values - shifted)[band].max() < 0.02 * np.abs(shifted[band]).max()


def test_files_of_time_records(tmp_path):
    """CSV, MATLAB to 7 and 7.3, HDF5 and Rattlesnake's netCDF4 give the same functions."""
    n = 1 << 13
    f = noise((n, 1))
    x, t = moved(f), np.arange(n) / RATE
    # In m/s2 by differences in frequency.
    hz = np.fft.rfftfreq(n, 1 / RATE)
    a = np.fft.irfft(-((2 * np.pi * hz)[:, None] ** 2) * np.fft.rfft(x, axis=0), n, axis=0)
    wanted = frfs_from_time(RATE, f, a)
    rows = ["time [s],force 5:+x [N],12:+z [m/s2],13:+y [m/s2]"]
    rows += [",".join(map(repr, map(float, row))) for row in np.column_stack([t, f, a])]
    (tmp_path / "r.csv").write_text("\n".join(rows) + "\n")
    own = {
        "time": t[:, None], "force": f, "response": a, "units": "m/s2/N",
        "response_points": np.array([[0, 0, 0.1], [0, 0.2, 0]]),
        "response_directions": np.array([[0, 0, 1.0], [0, 1.0, 0]]),
        "reference_points": np.zeros((1, 3)), "reference_directions": np.array([[1.0, 0, 0]]),
    }  # fmt: skip
    scipy.io.savemat(tmp_path / "five.mat", own)
    for name, matlab in (("r.h5", False), ("seven.mat", True)):
        with h5py.File(tmp_path / name, "w", userblock_size=512 if matlab else 0) as file:
            for key, value in own.items():
                if not matlab:
                    file[key] = value
                elif isinstance(value, str):
                    file[key] = np.array([[ord(c)] for c in value], np.uint16)
                    file[key].attrs["MATLAB_class"] = np.bytes_("char")
                else:
                    file[key] = np.asarray(value).T
                    file[key].attrs["MATLAB_class"] = np.bytes_("double")
    with h5py.File(tmp_path / "r.nc4", "w") as file:
        file["time_data"] = np.column_stack([f, a]).T
        file.attrs["sample_rate"] = RATE
        channels = {"node_number": ["5", "12", "13"], "node_direction": ["X+", "Z+", "Y+"]}
        for key, words in (channels | {"unit": ["N", "m/s2", "m/s2"]}).items():
            file[f"channels/{key}"] = words
    points = {"5": [0, 0, 0], "12": [0, 0, 0.1], "13": [0, 0.2, 0]}
    for name in ("r.csv", "five.mat", "seven.mat", "r.h5", "r.nc4"):
        more = {"points": points} if name in ("r.csv", "r.nc4") else {}
        found = read_frfs(tmp_path / name, **more)
        assert found.kind == "accelerance"
        assert found.values == pytest.approx(wanted.values, rel=1e-6, abs=1e-9), name
        assert found.coherence[:, :, 0] == pytest.approx(wanted.coherence)
        assert found.response_directions.tolist() == [[0, 0, 1], [0, 1, 0]]
        assert any("10 averages by H1" in note for note in found.notes)


def test_what_is_wrong_is_said(tmp_path):
    f = noise((4096, 1))
    for given, words in (
        ((RATE, f, moved(f)[:100]), "as many"),
        ((RATE, f, moved(f), TimeSettings(block=4.0)), "1 blocks of 4 s"),
        ((RATE, np.zeros_like(f), moved(f), TimeSettings(window="hammer")), "hits of a hammer"),
    ):
        with pytest.raises(InputError, match=words):
            frfs_from_time(*given)
    with pytest.raises(InputError, match="one of: H1, H2, Hv"):
        TimeSettings(estimator="H3")
    (tmp_path / "x.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(InputError, match="cannot be read as HDF5"):
        read_frfs(tmp_path / "x.h5")
    with h5py.File(tmp_path / "away.h5", "w") as file:
        file["frf"] = h5py.ExternalLink("/etc/passwd", "x")
        file["frequency"] = np.arange(3.0)
    with pytest.raises(InputError, match="frf is a struct"):
        read_frfs(tmp_path / "away.h5")
    with h5py.File(tmp_path / "away.nc4", "w") as file:
        file["time_data"] = h5py.ExternalLink("away.h5", "frequency")
        file.create_group("channels")
        file.attrs["sample_rate"] = RATE
    with pytest.raises(InputError, match="expected a file of Rattlesnake"):
        read_frfs(tmp_path / "away.nc4")
    with h5py.File(tmp_path / "huge.h5", "w") as file:
        file.create_dataset("frf", shape=(10**6, 10**6), dtype="f8", chunks=(1000, 1000))
        file["frequency"] = np.arange(3.0)
    with pytest.raises(InputError, match="at most"):
        read_frfs(tmp_path / "huge.h5")
