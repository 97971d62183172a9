"""The file of joint parameters: CSV, killed writers, several writers, other people's files."""

from __future__ import annotations

import csv
import sqlite3
import subprocess
import sys
import threading

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.database import JointRow, Store, seed_database
from fenics_joints.database.joints import settings_text
from fenics_joints.errors import InputError

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


def _awkward() -> list[JointRow]:
    rng = np.random.default_rng(1)
    texts = ['say "no", or;', "two\nlines, two\r\nends", " Ünïcode µ ", None]
    return [
        JointRow(
            diameter=float(rng.uniform(1e-3, 1e-1)),
            force=float(10 ** rng.uniform(-9, 9)),
            thickness=None if i % 3 else 0.1 + 0.2,
            radius=float(np.nextafter(0.4, 1)),
            nu=-0.25 if i % 2 else None,
            author=texts[i % 4],
            source=texts[(i + 1) % 4],
            settings=settings_text({"P_lim": 1e6, "mesh": [1, "fine"]}),
        )
        for i in range(12)
    ]


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


def test_what_a_killed_writer_left_half_written_is_undone_even_by_a_reader(tmp_path):
    path = tmp_path / "a.db"
    with Store(path, create=True) as store:
        store.add(seed_database().joints())
    size = path.stat().st_size
    subprocess.run([sys.executable, "-c", _HALF, str(path)], check=False)
    assert path.stat().st_size > 2 * size  # the file itself was written to
    with Store(path, readonly=True) as store:
        assert store.joints() == seed_database().joints()


def test_several_writers_at_once_lose_nothing(tmp_path):
    Store(tmp_path / "a.db", create=True).close()

    def write(force: float) -> None:
        with Store(tmp_path / "a.db") as store:
            for i in range(10):
                store.add([JointRow(diameter=0.012, force=force, thickness=0.01 + i, radius=0.03)])

    writers = [threading.Thread(target=write, args=(f,)) for f in (1.0, 2.0, 3.0, 4.0)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    with Store(tmp_path / "a.db") as store:
        assert len({(j.force, j.thickness) for j in store.joints()}) == 40


def test_no_empty_file_is_left_where_the_disk_is_full(tmp_path):
    """As of a disk that is full: no file may grow beyond 1 kB."""
    code = (
        "import resource, signal, sys\n"
        "from fenics_joints.database import Store\n"
        "from fenics_joints.errors import InputError\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))\n"
        "try:\n    Store(sys.argv[1], create=True)\n"
        "except InputError as error:\n    print('refused:', error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "new.db")], capture_output=True, text=True
    )
    assert "refused:" in done.stdout, done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_new_database_takes_no_other_place(tmp_path):
    """One that another process made meanwhile stays, with its rows."""
    with Store(tmp_path / "one.db", create=True) as first:
        first.add([JointRow(diameter=0.012, radius=0.04)])
        with Store(tmp_path / "one.db", create=True) as second:
            assert len(second.joints()) == 1
    assert [file.name for file in tmp_path.iterdir()] == ["one.db"]


def test_text_is_no_formula_in_a_spreadsheet_and_comes_back(tmp_path):
    """What Excel and LibreOffice would run (OWASP, CSV injection), and what only looks like it."""
    texts = ['=cmd|"/C calc"!A0', "@SUM(1+9)*cmd", "-2+3", "+1", "\t=1", " =1", "'=1", "''=1"]
    texts += ["\uff1d1", "'", "'s-Hertogenbosch", "a=b", ""]
    rows = [JointRow(diameter=0.012, radius=0.04, nu=-0.25, author=t or None) for t in texts]
    with Store(":memory:") as a, Store(":memory:") as b:
        a.add(rows)
        a.export_csv(tmp_path / "rows.csv")
        b.import_csv(tmp_path / "rows.csv")
        assert b.joints() == rows
    with (tmp_path / "rows.csv").open(newline="", encoding="utf-8") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    starts = {c[0] for c in map(str.strip, cells) if c and c not in ("-0.25",)}
    assert not starts & set("=+-@\t\r\uff1d") and cells.count("-0.25") == len(rows)


@pytest.mark.parametrize(
    "what",
    [
        "CREATE TRIGGER t AFTER INSERT ON joints BEGIN DELETE FROM joints; END",
        "CREATE VIEW v AS SELECT * FROM joints",
    ],
)
def test_a_database_has_tables_alone(tmp_path, what):
    path = tmp_path / "a.db"
    Store(path, create=True).close()
    other = sqlite3.connect(path)
    other.execute(what)
    other.commit()
    with pytest.raises(InputError, match="view or trigger"):
        Store(path)
