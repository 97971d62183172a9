"""Amplitude data of every kind, against the backbone of a Jenkins element in closed form.

Ring-downs are stepped in time; sweeps at constant force and at constant response are solutions of
the describing function; all with noise.
"""

from __future__ import annotations

import re
from dataclasses import replace

import measured_world as world
import numpy as np
import pytest
from jenkins import Jenkins, table

from fenics_joints.errors import InputError
from fenics_joints.measurements import read_amplitude, read_test_data
from fenics_joints.measurements.amplitude import (
    MeasuredBackbone,
    by_mode,
    from_ring_down,
    test_by_level,
)

JOINT = Jenkins()
SEEDS = range(4)
#: Issue data of the Brake-Reuss beam's first mode.
BRB = """level [m/s2],frequency [Hz],damping [%]
5,80.379,0.1451
20,80.204,0.1914
30,80.211,0.2342
40,80.132,0.2980
50,80.266,0.3706
60,80.344,0.4482
70,80.414,0.5487
80,80.455,0.6399
"""


HELD = "level [m/s2],frequency [Hz],force [N]\n"


def write(folder, name: str, text: str):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def off(found: MeasuredBackbone) -> np.ndarray:
    """Errors of frequency and damping in their stated deviations, (2, n)."""
    w = 2 * np.pi * found.frequencies_hz
    times = {"displacement": 0, "acceleration": 2}[found.response]
    f, zeta = JOINT.backbone(found.amplitudes / w**times)
    off_f = (found.frequencies_hz - f) / found.frequencies_sd
    return np.array([off_f, (found.damping - zeta) / found.damping_sd])


def noisy(h: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return h * (1 + 0.005 * (rng.normal(size=len(h)) + 1j * rng.normal(size=len(h))))


def check(errors: list[np.ndarray], most: float = 2.0) -> None:
    """All within what is stated: nine in ten within 1.96 deviations (95 % of them, if no more)."""
    errors = np.concatenate(errors, axis=1)
    assert (np.mean(np.abs(errors) < 1.96, axis=1) >= 0.9).all()
    assert (np.sqrt(np.mean(errors**2, axis=1)) < most).all()


@pytest.fixture(scope="module")
def decay():
    """Times and accelerations of a decay from twenty times where the slider yields."""
    dt = 1 / JOINT.hz / 640
    times, _, accelerations = JOINT.motion(0.0, int(4 / dt), dt, x=20 * JOINT.yields_at)
    return times[::16], accelerations[::16]


def test_ring_down_gives_the_closed_form_within_its_deviations(decay):
    times, signal = decay
    errors = []
    for seed in SEEDS:
        noise = np.random.default_rng(seed).normal(0, 5e-4 * signal.max(), len(signal))
        found = from_ring_down(times, signal + noise, "acceleration")
        errors.append(off(found))
        assert found.kind == "ring-down" and len(found) >= 8
        # It goes down to where the slider sticks, and up to where most of it slips.
        assert found.frequencies_hz[0] > 79.9 > 79.3 > found.frequencies_hz[-1]
        assert np.median(found.damping_sd / found.damping) < 0.05
    check(errors)


def test_ring_down_of_two_sensors_and_two_modes(decay, tmp_path):
    """A second mode at 230 Hz is kept out; the sensors have their own noise and share."""
    times, signal = decay
    rng = np.random.default_rng(1)
    other = 0.5 * signal.max() * np.exp(-2 * times) * np.cos(2 * np.pi * 230 * times)
    a, b = (
        share * signal + way * other + rng.normal(0, 5e-4 * signal.max(), len(times))
        for share, way in ((1.0, 1.0), (-1.5, 0.7))
    )
    hammer = np.where(times < 2e-3, 100.0, 0.0)
    text = table("time [ms],a1 [m/s2],a2 [g],hammer [N]", 1e3 * times, a, b / 9.80665, hammer)
    path = write(tmp_path, "hit.csv", text)
    found = read_amplitude(path, sensor="a1", band=(70, 90))
    assert found.response == "acceleration"
    check([off(found)])
    larger = read_amplitude(path, sensor="a2", band=(70, 90))
    assert larger.amplitudes == pytest.approx(1.5 * found.amplitudes, rel=1e-3)
    with pytest.raises(InputError, match="has the sensors a1, a2; expected sensor"):
        read_amplitude(path)


def test_constant_force_gives_the_closed_form_whatever_it_folds(tmp_path):
    """Three levels; a phase whose sign is turned round; jumps do not matter."""
    errors, f = [], np.linspace(78.6, 80.8, 45)
    for seed in SEEDS:
        rng, columns = np.random.default_rng(seed), []
        for level in (0.03, 0.1, 0.4):
            h = -((2 * np.pi * f) ** 2) * JOINT.held(level, f)
            h = noisy(h, rng)
            columns.append((np.full(len(f), level), f, level * np.abs(h), -np.angle(h, deg=True)))
        head = "level [N],frequency [Hz],amplitude [m/s2],phase [deg]"
        text = table(head, *np.concatenate(columns, axis=1))
        found = read_amplitude(write(tmp_path, "sweeps.csv", text))
        assert found.kind == "constant force" and found.response == "acceleration"
        assert len(found) >= 6
        errors.append(off(found))
    check(errors)


@pytest.mark.parametrize("phase", [True, False])
def test_constant_response_gives_the_closed_form(tmp_path, phase):
    """The force that held an acceleration, with its phase or without."""
    f, errors = np.linspace(78.8, 80.6, 37), []
    for seed in SEEDS:
        rng, columns = np.random.default_rng(seed), []
        for level in (2.0, 8.0, 15.0, 30.0, 60.0):
            h = JOINT.at_acceleration(level, f)
            h = noisy(h, rng)
            columns.append((np.full(len(f), level), f, level / np.abs(h), np.angle(h, deg=True)))
        columns = np.concatenate(columns, axis=1)[: 4 if phase else 3]
        head = "level [m/s2],frequency [Hz],force [N]" + phase * ",phase [deg]"
        found = read_amplitude(write(tmp_path, "held.csv", table(head, *columns)))
        assert found.kind == "constant response" and len(found) == 5
        assert found.amplitudes == pytest.approx([2, 8, 15, 30, 60])
        errors.append(off(found))
    check(errors)


def test_universal_files_of_functions_and_of_decays(decay, tmp_path):
    pytest.importorskip("pyuff")
    f = np.linspace(78.8, 80.6, 37)
    sets = [
        world.function(0, 0, x=f, data=JOINT.at_acceleration(level, f)) for level in (2.0, 30.0)
    ]
    world.write_uff(tmp_path / "held.uff", *sets)
    given = {"levels": ["2 m/s2", "30 m/s2"], "units": "m/s2/N"}
    found = read_amplitude(tmp_path / "held.uff", **given)
    f0, zeta0 = JOINT.backbone(np.array([2.0, 30.0]) / (2 * np.pi * found.frequencies_hz) ** 2)
    assert found.frequencies_hz == pytest.approx(f0, rel=1e-4)
    assert found.damping == pytest.approx(zeta0, rel=0.02)
    with pytest.raises(InputError, match="1 of them for 2 FRFs"):
        read_amplitude(tmp_path / "held.uff", levels=["2 m/s2"], units="m/s2/N")
    with pytest.raises(InputError, match=r"type 4.*the level of each in levels"):
        read_amplitude(tmp_path / "held.uff")
    times, signal = decay
    time = {"func_type": 1, "orddenom_spec_data_type": 0, "abscissa_spec_data_type": 17}
    one = world.function(0, 0, x=times, data=signal / 9.80665, **time)
    world.write_uff(tmp_path / "decay.uff", one, one)
    twice = read_amplitude(tmp_path / "decay.uff")  # two hits
    alone = from_ring_down(times, signal, "acceleration")
    assert len(twice) == 2 * len(alone)
    assert twice.frequencies_hz[::2] == pytest.approx(alone.frequencies_hz, rel=1e-6)


def test_plain_table_and_the_test_that_a_diagnosis_makes_of_it(tmp_path):
    found = read_amplitude(write(tmp_path, "brb.csv", BRB), noise=5e-4, damping_noise=0.05)
    assert found.kind == "backbone" and len(found) == 8
    assert found.damping[-1] == pytest.approx(0.006399)
    data = test_by_level({"bending 1": found})
    assert data.by_level and data.condition_unit == "m/s2"
    assert data.conditions == pytest.approx([5, 20, 30, 40, 50, 60, 70, 80])
    assert data.frequencies_hz[:, 0] == pytest.approx(found.frequencies_hz)
    assert data.noise == pytest.approx([5e-4]) and data.damping_noise == pytest.approx(0.05)
    # The same as the tables of a test by level give, in whichever unit.
    in_g = re.sub(r"^(\d+)", lambda m: f"{int(m[1]) / 9.80665:.12g}", BRB, flags=re.M)
    in_g = write(tmp_path, "g.csv", in_g.replace("level [m/s2]", "acceleration [g]"))
    assert read_amplitude(in_g).amplitudes == pytest.approx(found.amplitudes)
    as_test = read_test_data(tmp_path / "brb.csv", condition="level", modes=["frequency"])
    assert as_test.damping == pytest.approx(data.damping)


def test_few_levels_of_many_points_are_means_by_their_precision():
    a = np.geomspace(1, 100, 40)
    rng = np.random.default_rng(2)
    sd = np.full(40, 0.1)
    f = 80 - 0.2 * np.log(a) + rng.normal(0, sd)
    many = MeasuredBackbone("acceleration", a, f, sd, np.full(40, np.nan), np.full(40, np.nan))
    few = many.averaged(8)
    assert len(few) == 8 and not few.has_damping
    assert ((few.frequencies_sd > 0.99 * 0.1 / np.sqrt(5)) & (few.frequencies_sd < 0.1)).all()
    assert few.frequencies_hz == pytest.approx(80 - 0.2 * np.log(few.amplitudes), abs=0.2)
    assert test_by_level({"b": many}).damping is None


def test_two_modes_at_levels_of_their_own_and_back(tmp_path):
    one = read_amplitude(write(tmp_path, "brb.csv", BRB), noise=5e-4, damping_noise=0.05)
    text = "acceleration [m/s2],frequency [Hz]\n20,295\n300,290\n"
    two = read_amplitude(write(tmp_path, "two.csv", text), noise=1e-3)
    data = test_by_level({"bending 1": one, "bending 2": two})
    assert data.frequencies_hz.shape == (9, 2) and np.isfinite(data.frequencies_hz[:, 1]).sum() == 2
    back = by_mode(data)
    assert back["bending 1"].frequencies_sd == pytest.approx(one.frequencies_sd)
    assert back["bending 1"].damping_sd == pytest.approx(one.damping_sd)
    assert back["bending 2"].amplitudes == pytest.approx([20, 300])
    force = replace(two, response="force")
    with pytest.raises(InputError, match="of acceleration and force; expected one kind"):
        test_by_level({"bending 1": one, "bending 2": force})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"bad.csv: has 0 rows"),
        ("level [m/s2],frequency [Hz]\n5,80,3\n", "row 2 has 3 cells, expected 2"),
        ("level,frequency [Hz]\n5,80\n", r"column 'level': the unit is missing.*\[m/s2\]"),
        ("level [kg],frequency [Hz]\n5,80\n", "'kg' is none of a level"),
        ("level [m/s2],frequency\n5,80\n", r"expected its unit in brackets, such as 'frequency"),
        ("level [m/s2],frequency [Hz]\n5,\n", "'frequency', data row 1 is empty"),
        ("level [m/s2],frequency [Hz],damping\n5,80,1.5\n", "damping ratio between 0 and 1"),
        ("a,b\n1,2\n", "expected amplitude data of one mode"),
        ("level [m/s2],frequency [Hz],phase [deg]\n5,80,3\n", "expected the force that held it"),
        ("level [N],frequency [Hz],force [N]\n5,80,3\n", "expected the response too"),
        ("level [N],frequency [Hz],amplitude [m/s2]\n5,80,3\n", "1 different frequencies"),
        (
            HELD + "".join(f"5,{70 + i},{9 - i}\n" for i in range(9)),
            "5 m/s2: .*largest at .* 78 Hz",
        ),
        ("time [s],force [N]\n0,1\n1,2\n", "has no response beside the time"),
        ("time [s],a [m/s2]\n0,1\n1,2\n", "has 2 samples; expected 64"),
        ("time [s],a\n0,1\n1,2\n", "column 'a': the unit is missing"),
    ],
)
def test_what_is_wrong_in_a_table_is_said(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_amplitude(write(tmp_path, "bad.csv", text))
    with pytest.raises(InputError, match="no such file, expected amplitude data"):
        read_amplitude(tmp_path / "none.csv")


def test_what_is_wrong_in_a_record_is_said(decay):
    times, signal = decay
    swapped = times.copy()
    swapped[[100, 101]] = times[[101, 100]]
    noise = np.random.default_rng(0).normal(size=len(times))
    for t, a, band, words in (
        (swapped, signal, None, r"at sample 10[123]; expected ascending"),
        (times, signal, (1e3, 1e4), "expected one between 0 and"),
        (times, noise, (70, 90), "free decay above the noise|decay is"),
        (times[:200], signal[:200], (70, 90), "decay is .* s long; expected more than"),
    ):
        with pytest.raises(InputError, match=words):
            from_ring_down(t, a, "acceleration", band=band)
