"""The database of joint parameters: file, Kriging, sweep and query."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mpi4py")
pytest.importorskip("sklearn")

from mpi4py import MPI

from fenics_joints.database.joints import Joint, settings_text
from fenics_joints.database.kriging import Kriging
from fenics_joints.database.query import Surfaces, TorqueToForce, query
from fenics_joints.database.store import Store, seed_database
from fenics_joints.database.sweep import Sample, grid, sweep
from fenics_joints.errors import InputError
from fenics_joints.preload.torque import motosh_force

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")

#: Seed 000, Table 4: force in N, thickness in m. Table 5 has the paper's errors there, in per cent.
TESTING = [(12.5e3, 0.030), (25e3, 0.015), (37.5e3, 0.025), (50e3, 0.020), (62.5e3, 0.035)]
PAPER_ERRORS = [1.03, 1.44, 0.22, 1.35, 0.41]


@pytest.fixture(scope="module")
def seed_tables():
    """Conditions (force, thickness), radius and pressure of seed 000, Tables 2 and 3."""
    rows = [j for j in seed_database().joints() if j.radius]
    x = np.array([(j.force, j.thickness) for j in rows])
    return x, np.array([j.radius for j in rows]), np.array([j.pressure for j in rows])


@pytest.fixture(scope="module")
def seed_surfaces():
    """Kriging of all 35 rows."""
    return Surfaces.fit(seed_database())


def _fit(x, y):
    return Kriging.fit(x, y, inputs=("force", "thickness"), output="radius")


# -- Kriging ---------------------------------------------------------------------------------------


@serial
def test_errors_at_the_papers_testing_points_are_below_its_own(seed_tables):
    """30 sample points, 5 testing points; the latter have no part in fit or choice of the model."""
    x, radius, pressure = seed_tables
    testing = np.array([tuple(point) in TESTING for point in x])
    assert testing.sum() == 5 and len(x) == 35
    errors = {}
    for name, y in (("radius", radius), ("pressure", pressure)):
        predicted = _fit(x[~testing], y[~testing]).predict(x[testing])
        errors[name] = np.abs(predicted.value / y[testing] - 1)
        # Its own uncertainty covers each of the five.
        assert np.all((predicted.low < y[testing]) & (y[testing] < predicted.high))
    assert errors["radius"].mean() < np.mean(PAPER_ERRORS) / 100
    # The paper has no such figure for the pressure, which follows the radius squared.
    assert errors["pressure"].mean() < 2 * np.mean(PAPER_ERRORS) / 100


@serial
def test_leave_one_out_over_all_rows_is_what_the_conditional_gaussian_says(seed_surfaces):
    """One process's leave-one-out by removing each point in turn; and the spread is calibrated."""
    for kriging in seed_surfaces.kriging.values():
        left = kriging.leave_one_out()
        assert len(left.error) == 35 and np.abs(left.error).mean() < 0.03
        assert 0.7 < left.standardised.std() < 1.3
        assert np.mean(np.abs(left.standardised) < 1.96) > 0.85
    member = dataclasses.replace(kriging.members[0], weight=1.0)
    single = Kriging(kriging.inputs, kriging.output, kriging.x, kriging.y, [member])
    z = kriging.x[:, np.ptp(kriging.x, axis=0) > 0]
    logs = np.array([s == "log" for s in member.scales])
    z = np.where(logs, np.log(z), z)
    covariance = single.processes[0].kernel_((z - z.mean(0)) / z.std(0))
    log_y, left = np.log(kriging.y), single.leave_one_out()
    for i in (0, 8, 34):
        others = np.arange(35) != i
        weights = np.linalg.solve(covariance[np.ix_(others, others)], covariance[others, i])
        mean = log_y[others].mean()
        predicted = mean + weights @ (log_y[others] - mean)
        variance = log_y.var() * (covariance[i, i] - weights @ covariance[others, i])
        assert left.value[i] == pytest.approx(math.exp(predicted), rel=1e-8)
        z_score = (predicted - log_y[i]) / math.sqrt(variance)
        assert left.standardised[i] == pytest.approx(z_score, rel=1e-6)


@serial
def test_a_power_law_is_found_from_few_points_and_its_uncertainty_covers_noise():
    rng = np.random.default_rng(4)
    x = np.column_stack([rng.uniform(1e4, 7e4, 40), rng.uniform(0.01, 0.04, 40)])
    truth = 2e-3 * x[:, 0] ** 0.2 * x[:, 1] ** 0.3
    noise = 0.02
    kriging = _fit(x, truth * np.exp(noise * rng.standard_normal(40)))
    inside = np.column_stack([rng.uniform(3e4, 5e4, 50), rng.uniform(0.02, 0.03, 50)])
    predicted = kriging.predict(inside)
    assert (
        np.abs(predicted.value / (2e-3 * inside[:, 0] ** 0.2 * inside[:, 1] ** 0.3) - 1).max()
        < noise
    )
    assert np.all(predicted.sd / predicted.value > 0.7 * noise)
    assert np.all(predicted.sd / predicted.value < 1.5 * noise)


@serial
def test_saved_kriging_predicts_the_same_and_is_json(seed_surfaces, tmp_path):
    kriging = seed_surfaces.kriging["radius"]
    kriging.save(tmp_path / "radius.json")
    again = Kriging.load(tmp_path / "radius.json")
    points = np.array([[0.012, 2e4, 0.011], [0.012, 6e4, 0.039], [0.012, 33e3, 0.0222]])
    for name in ("value", "sd", "low", "high"):
        expected = getattr(kriging.predict(points), name)
        assert np.allclose(getattr(again.predict(points), name), expected, rtol=1e-10, atol=0)
    for damage in ({"format": "other"}, {"version": 99}, {"members": [{}]}):
        (tmp_path / "bad.json").write_text(json.dumps(kriging.to_json() | damage))
        with pytest.raises(InputError, match="bad.json"):
            Kriging.load(tmp_path / "bad.json")


@serial
def test_extrapolation_is_refused_or_marked():
    """A triangle of data: the corner opposite is inside the box of the data, but not the hull."""
    i, j = np.array([(i, j) for i in range(5) for j in range(5 - i)]).T
    x = np.column_stack([1e4 * (1 + i), 0.01 * (1 + j)])
    kriging = _fit(x, 0.01 * (1 + 0.1 * i + 0.2 * j))
    inside, corner = [2e4, 0.02], [4.5e4, 0.045]
    assert kriging.predict(np.array([inside])).inside[0]
    assert kriging.predict(x).inside.all()
    with pytest.raises(InputError, match="force 45.0 kN, thickness 45.0 mm would be extrapolated"):
        kriging.predict(np.array([inside, corner]))
    both = kriging.predict(np.array([inside, corner]), extrapolate=True)
    assert both.inside.tolist() == [True, False]
    assert both.sd[1] / both.value[1] > both.sd[0] / both.value[0]


# -- file ------------------------------------------------------------------------------------------


def _awkward() -> list[Joint]:
    rng = np.random.default_rng(1)
    texts = ['say "no", or;', "two\nlines, two\r\nends", " Ünïcode µ ", None]
    return [
        Joint(
            diameter=float(rng.uniform(1e-3, 1e-1)), force=float(10 ** rng.uniform(-9, 9)),
            thickness=None if i % 3 else 0.1 + 0.2, radius=float(np.nextafter(0.04, 1)),
            nu=-0.25 if i % 2 else None, author=texts[i % 4], source=texts[(i + 1) % 4],
            settings=settings_text({"P_lim": 1e6, "mesh": [1, "fine"]}),
        )
        for i in range(12)
    ]  # fmt: skip


@serial
def test_csv_keeps_every_digit_and_letter(tmp_path):
    rows = _awkward() + seed_database().joints()
    with Store(tmp_path / "a.db", create=True) as a, Store(tmp_path / "b.db", create=True) as b:
        a.add(rows)
        a.export_csv(tmp_path / "rows.csv")
        assert b.import_csv(tmp_path / "rows.csv") == len(rows)
        assert b.joints() == rows and b.csv_text() == a.csv_text()
    (tmp_path / "hand.csv").write_text("diameter [mm],force [kN],radius [mm]\n12,50,43\n")
    with Store(tmp_path / "a.db") as a:
        a.import_csv(tmp_path / "hand.csv")
        last = a.joints()[-1]
        assert (last.diameter, last.force, last.radius) == pytest.approx((0.012, 50e3, 0.043))


@serial
@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("diameter [mm],radius [mm]\n12,43\n12,-1\n", "line 3: radius = -0.001.*above 0"),
        ("diameter [mm],radius [mm]\n12\n", "line 2: 1 cells, expected 2"),
        ("diameter [mm],radius [kg]\n12,43\n", "column 'radius .kg.'"),
        ("diameter [mm],size [mm]\n12,43\n", "column 'size .mm.', expected one of diameter"),
        ("diameter [m],force [N]\n0.012,5e4\n", "line 2: row has no result"),
    ],
)
def test_a_wrong_csv_is_named_and_nothing_of_it_is_kept(tmp_path, text, match):
    (tmp_path / "wrong.csv").write_text(text)
    with Store(tmp_path / "a.db", create=True) as store:
        with pytest.raises(InputError, match=f"wrong.csv: {match}"):
            store.import_csv(tmp_path / "wrong.csv")
        assert store.joints() == []


@serial
def test_what_is_no_such_database_is_a_clear_error(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        Store(tmp_path / "none.db")
    (tmp_path / "text.db").write_text("not a database " * 100)
    with pytest.raises(InputError, match="text.db: .*expected a database of joint parameters"):
        Store(tmp_path / "text.db")
    other = sqlite3.connect(tmp_path / "other.db")
    other.execute("CREATE TABLE joints (id)")
    other.commit()
    for create in (False, True):
        with pytest.raises(InputError, match="other.db: is an SQLite file of another program"):
            Store(tmp_path / "other.db", create=create)
    Store(tmp_path / "new.db", create=True).close()
    newer = sqlite3.connect(tmp_path / "new.db")
    newer.execute("PRAGMA user_version = 99")
    newer.commit()
    with pytest.raises(InputError, match="new.db: has schema 99, expected 1"):
        Store(tmp_path / "new.db")
    Store(tmp_path / "read.db", create=True).close()
    with Store(tmp_path / "read.db", readonly=True) as store:
        with pytest.raises(InputError, match="can be written to"):
            store.add(_awkward())


_HALF = """
import os, signal, sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("PRAGMA cache_size = 1")  # spills to the file before the commit
connection.execute("BEGIN IMMEDIATE")
for i in range(2000):
    connection.execute("INSERT INTO joints (diameter, author) VALUES (1, hex(randomblob(400)))")
os.kill(os.getpid(), signal.SIGKILL)
"""


@serial
def test_what_a_killed_writer_left_half_written_is_undone_even_by_a_reader(tmp_path):
    path = tmp_path / "a.db"
    with Store(path, create=True) as store:
        store.add(seed_database().joints())
    size = path.stat().st_size
    subprocess.run([sys.executable, "-c", _HALF, str(path)], check=False)
    assert path.stat().st_size > 2 * size  # the file itself was written to
    with Store(path, readonly=True) as store:
        assert store.joints() == seed_database().joints()


# -- sweep -----------------------------------------------------------------------------------------


def closed_form(sample: Sample, factor: float = 1.0) -> dict[str, float]:
    """A power law, and no answer for the thickest plate."""
    if sample.thickness > 0.035:
        raise ValueError("too thick")
    radius = factor * 2e-3 * sample.force**0.2 * sample.thickness**0.3
    return {"radius": radius, "pressure": sample.force / (math.pi * radius**2)}


SAMPLES = grid(["M12"], [2e4, 3e4, 4e4, 5e4], [0.01, 0.02, 0.03, 0.04])


@pytest.mark.parallel
def test_ranks_share_a_sweep_and_a_failed_sample_stops_no_other(shared_tmp_path):
    comm = MPI.COMM_WORLD
    path = shared_tmp_path / "joints.db"
    if comm.rank == 0:
        Store(path, create=True).close()
    comm.barrier()
    calls = []

    def analyse(sample, **settings):
        calls.append(sample)
        time.sleep(0.02)
        return closed_form(sample, **settings)

    with Store(path) as store:
        first = sweep(SAMPLES, analyse, store, comm, model="law", settings={"factor": 1.5})
        here = comm.allgather(calls)
        assert sorted(map(repr, sum(here, []))) == sorted(map(repr, SAMPLES))  # each one once
        assert all(here)  # by all ranks
        assert first.computed == 12 and len(first.failed) == 4
        assert set(first.failed.values()) == {"ValueError: too thick"}
        rows = {(j.force, j.thickness): j for j in store.joints()}
        for s in SAMPLES:
            if s.thickness < 0.035:
                assert rows[s.force, s.thickness].radius == closed_form(s, 1.5)["radius"]
        row = rows[2e4, 0.01]
        assert (row.model, row.settings, row.bolt) == ("law", '{"factor": 1.5}', "M12")
        assert row.version.startswith("fenics-joints") and row.date and row.author
        # Again: nothing is computed; with other settings, all; with retry, what failed.
        calls.clear()
        again = sweep(SAMPLES, analyse, store, comm, model="law", settings={"factor": 1.5})
        assert (again.computed, again.finished_before) == (0, 12)
        assert again.failed == first.failed and not any(comm.allgather(calls))
        sweep(SAMPLES, lambda s, **_: {"radius": 0.03}, store, comm, model="law",
              settings={"factor": 1.5}, retry=True)  # fmt: skip
        assert len(store.joints()) == 16


_SLOW = """
import os, time
from pathlib import Path

def analyse(sample, folder):
    with open(Path(folder) / "calls", "a") as calls:
        calls.write(f"{sample.force:g} {sample.thickness:g}\\n")
    time.sleep(0.15)
    return {"radius": 1e-6 * sample.force * sample.thickness}
"""


@serial
def test_a_killed_sweep_goes_on_and_loses_or_repeats_nothing_finished(tmp_path):
    """Two ranks if there is mpirun, killed by SIGKILL amid a sample; then again to the end."""
    (tmp_path / "slow_analysis.py").write_text(_SLOW)
    database = tmp_path / "joints.db"
    command = [
        sys.executable, "-m", "fenics_joints", "database", "sweep", "--db", str(database),
        "--bolt", "M12", "--force", "10, 20, 30, 40 kN", "--thickness", "10, 20, 30 mm",
        "--analysis", "slow_analysis:analyse", "--set", f"folder={tmp_path}",
    ]  # fmt: skip
    if shutil.which("mpirun"):
        command = ["mpirun", "-n", "2", *command]
    environment = {
        k: v for k, v in os.environ.items() if not k.startswith(("OMPI_COMM_", "PMIX_", "PMI_"))
    }
    environment["PYTHONPATH"] = str(tmp_path)

    def rows() -> list[Joint]:
        if not database.exists():
            return []
        with Store(database) as store:
            return store.joints()

    def start():
        return subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip

    run = start()
    end = time.monotonic() + 60
    while not 3 <= len(_rows_or_none(rows)) < 12:
        assert run.poll() is None and time.monotonic() < end, run.stderr.read()
        time.sleep(0.02)
    _kill_ranks(str(database))
    run.communicate()
    before, called = rows(), (tmp_path / "calls").read_text().splitlines()
    assert 3 <= len(before) < 12
    again = start()
    _, errors = again.communicate(timeout=60)
    assert again.returncode == 0, errors
    after = rows()
    assert after[: len(before)] == before and len(after) == 12
    assert {(j.force, j.thickness) for j in after} == {
        (f, b) for f in (1e4, 2e4, 3e4, 4e4) for b in (0.01, 0.02, 0.03)
    }
    # What was finished before the kill was not called again.
    later = (tmp_path / "calls").read_text().splitlines()[len(called) :]
    assert len(later) == 12 - len(before)
    assert not {f"{j.force:g} {j.thickness:g}" for j in before} & set(later)


def _rows_or_none(rows) -> list[Joint]:
    """The database may be there without its tables for a moment."""
    try:
        return rows()
    except InputError:
        return []


def _kill_ranks(word: str) -> None:
    """SIGKILL to what has the word, which only this test uses, among its arguments."""
    end = time.monotonic() + 20
    while time.monotonic() < end:
        alive = [p for p in Path("/proc").glob("[0-9]*") if word.encode() in _arguments(p)]
        if not alive:
            return
        for process in alive:
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(process.name), signal.SIGKILL)
        time.sleep(0.05)
    raise AssertionError(f"not killed: {alive}")


def _arguments(process: Path) -> bytes:
    try:
        return (process / "cmdline").read_bytes()
    except OSError:
        return b""


@serial
def test_several_writers_at_once_lose_nothing(tmp_path):
    Store(tmp_path / "a.db", create=True).close()

    def write(force: float) -> None:
        with Store(tmp_path / "a.db") as store:
            for i in range(10):
                store.add([Joint(diameter=0.012, force=force, thickness=0.01 + i, radius=0.03)])

    writers = [threading.Thread(target=write, args=(f,)) for f in (1.0, 2.0, 3.0, 4.0)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    with Store(tmp_path / "a.db") as store:
        assert len({(j.force, j.thickness) for j in store.joints()}) == 40


# -- query -----------------------------------------------------------------------------------------


@serial
def test_torque_bolt_and_plates_to_radius_pressure_and_the_identified_interface(seed_surfaces):
    """The engraving machine of seed 000: Table 10 to Table 11, and Table 2 at 50 kN, 25 mm."""
    answer = query(seed_surfaces, bolt="M12", torque=120.0, thickness=0.025, roughness=1.6e-6)
    assert answer.force == pytest.approx(50e3) and "K = 0.2" in answer.force_from
    assert answer.radius.low < 0.05155 < answer.radius.high and not answer.extrapolated
    assert answer.pressure.low < 5.89e6 < answer.pressure.high
    assert (answer.identified.E, answer.identified.nu, answer.identified.h) == (
        6.111e9,
        0.253,
        7.2e-4,
    )
    assert "the conditions that were asked" in answer.identified_note
    json.dumps(answer.json(), allow_nan=False)


@serial
def test_another_way_to_force_and_other_conditions_are_said(seed_surfaces):
    motosh = query(seed_surfaces, bolt="M12", torque=60.0, thickness=0.02,
                   torque_to_force=TorqueToForce(friction=0.12))  # fmt: skip
    assert motosh.force == pytest.approx(motosh_force(60.0, "M12", 0.12, 0.12))
    assert "Motosh" in motosh.force_from and "0.12" in motosh.force_from
    assert "force, thickness differ" in motosh.identified_note
    with pytest.raises(InputError, match="diameter 12.0 mm only"):
        query(seed_surfaces, bolt="M16", force=3e4, thickness=0.02)
    other = query(seed_surfaces, bolt="M16", torque=90.0, thickness=0.04, extrapolate=True)
    assert other.extrapolated and any("no effect of it" in note for note in other.notes)
    assert other.identified.h == 0.657e-3 and "thickness is not known" in other.identified_note


@serial
@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"bolt": "M12", "thickness": 0.02}, "a torque or a force"),
        ({"bolt": "M12", "thickness": 0.02, "torque": 9.0, "force": 1e4}, "a torque or a force"),
        ({"bolt": "M12", "thickness": -0.02, "force": 3e4}, "thickness = -0.02"),
        ({"bolt": "M11", "thickness": 0.02, "force": 3e4}, "'M11' is not in the table"),
    ],
)
def test_a_bad_question_is_an_input_error(seed_surfaces, arguments, match):
    with pytest.raises(InputError, match=match):
        query(seed_surfaces, **arguments)


@serial
def test_rows_of_two_models_are_never_mixed():
    store = seed_database()
    store.add(
        Joint(diameter=0.012, force=f, thickness=b, radius=0.02, model="other")
        for f in (1e4, 2e4, 3e4) for b in (0.01, 0.02)
    )  # fmt: skip
    with pytest.raises(InputError, match="several models, expected one: contact .*; other"):
        Surfaces.fit(store)
    assert len(Surfaces.fit(store, "other").rows) == 6


# -- command ---------------------------------------------------------------------------------------


def _run(*arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "fenics_joints", "database", *map(str, arguments)],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip


@serial
def test_command_adds_and_answers(tmp_path):
    database, out = tmp_path / "own.db", tmp_path / "answer.json"
    seed_database().export_csv(tmp_path / "rows.csv")
    assert _run("add", "--db", database, "--csv", tmp_path / "rows.csv").returncode == 0
    added = _run("add", "--db", database, "--bolt", "M12", "--torque", "96 N·m", "--thickness",
                 "25 mm", "--E", "5 GPa", "--nu", 0.25, "--h", "0.7 mm")  # fmt: skip
    assert added.returncode == 0 and "has 38 now" in added.stdout
    asked = _run("query", "--db", database, "--torque", "96 N·m", "--bolt", "M12", "--thickness",
                 "25 mm", "--json", out)  # fmt: skip
    assert asked.returncode == 0, asked.stderr
    answer = json.loads(out.read_text())
    assert answer["force_N"] == pytest.approx(40e3) and answer["identified"]["E"] == 5e9
    assert answer["radius_m"]["low"] < 0.0502 < answer["radius_m"]["high"]
    assert "T = K d F" in asked.stdout and "mm" in asked.stdout
    wrong = _run("query", "--torque", "96", "--bolt", "M12", "--thickness", "25 mm")
    assert wrong.returncode == 1
    assert "error: --torque '96': expected a number with its unit" in wrong.stderr
