"""All benchmarks beside their peers and limits, in one table.

    python3 benchmarks/run.py [NAME ...] [--quick] [--write]

Each row runs a script of this folder, which measures both sides in one run, and picks a number from
its JSON. All rows take an hour and a half and 20 GiB; ``--quick`` takes small models and some
minutes, and its numbers are of these models. They go to ``benchmarks/results.json`` or
``quick.json`` with what the machine is and how busy it was; rows that are not run keep what they
had. ``--write`` puts the table into ``docs/speed.md`` and the times of the README's first command
into ``README.md``. Needs nothing but Python itself where it is started.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from statistics import median

from harness import ROOT, launcher, parser, run, threads, write

HERE = Path(__file__).resolve().parent
PAGES = {"table": ROOT / "docs" / "speed.md", "time": ROOT / "README.md"}


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        what: What is compared with what.
        command: Script and arguments.
        quick: The same for small models; empty where only large ones show something.
        number: Picks the number from the script's JSON.
        target: What is aimed at: ``>`` or ``<`` and a number.
        detail: Picks what the sizes and times were.
        enters: Whether the script enters FEniCSx itself.
    """

    what: str
    command: str
    quick: str
    number: Callable[[dict], float]
    target: str
    detail: Callable[[dict], str] = lambda found: ""
    enters: bool = False


def _modal_sides(peer: str, name: str) -> Callable[[dict], str]:
    def sides(found: dict) -> str:
        ours, theirs = (
            median(pair[side]["wall"] for pair in found["runs"]) for side in ("ours", peer)
        )
        return f"{found['dofs']:,} DOFs: {ours:.1f} s, {name} {theirs:.1f} s"

    return sides


def _contact_sides(found: dict) -> str:
    wall = found["wall"]
    ours, ccx = wall[found["ours"]], wall[found["ccx"]]
    return f"{found['detail']['dofs']:,} DOFs: {ours:.1f} s, CalculiX {ccx:.1f} s"


def _iterative_sides(found: dict) -> str:
    row = found["ratios"][-1]
    return f"{row['dofs']:,} DOFs, in {row['seconds']:.1f} times the time"


def _growth(key: str, rows: str) -> Callable[[dict], float]:
    """Most over least of a number of iterations over the sizes."""
    return lambda found: max(row[key] for row in found[rows]) / min(row[key] for row in found[rows])


def _listed(key: str, rows: str, unit: str = "") -> Callable[[dict], str]:
    """A number of each size, and its unit."""

    def listed(found: dict) -> str:
        return "; ".join(f"{row['dofs']:,} DOFs: {row[key]:,.4g}" for row in found[rows]) + unit

    return listed


def _exponent(found: dict) -> float:
    first, last = found["sizes"][0], found["sizes"][-1]
    return math.log(last["wall"] / first["wall"]) / math.log(last["dofs"] / first["dofs"])


MODAL, SMALL = "modal.py --runs 5", "modal.py --runs 1 --elements 30 12 2"
SIZES = "contact.py --sizes"
WITHOUT = "iterative.py --sizes 0.06 0.03 0.018 0.0105 --methods iterative --ranks 2"
ROWS = {
    "modal": Row(
        "Twelve modes of lapped plates, whole processes: time of CalculiX over ours",
        MODAL,
        SMALL,
        lambda found: found["times_faster_wall"],
        "> 6",
        _modal_sides("ccx", "CalculiX"),
        enters=True,
    ),
    "modal_large": Row(
        "The same on twice the degrees of freedom",
        "modal.py --runs 1 --elements 86 34 4",
        "",
        lambda found: found["times_faster_wall"],
        "> 8",
        _modal_sides("ccx", "CalculiX"),
        enters=True,
    ),
    "floor": Row(
        "The eigenproblem over one factorisation with its solves by MUMPS alone",
        MODAL,
        SMALL,
        lambda found: found["floor"]["ratio"],
        "< 1.1",
        lambda found: f"{found['dofs']:,} DOFs",
        enters=True,
    ),
    "slepc": Row(
        "The same modes by a script of DOLFINx and SLEPc alone: its time over ours",
        MODAL,
        SMALL,
        lambda found: found["slepc"]["times_slower"],
        "> 1",
        _modal_sides("slepc", "SLEPc"),
        enters=True,
    ),
    "contact": Row(
        "Bolted plates with contact, whole processes: time of CalculiX over ours",
        "contact.py --runs 3 --kinds 'node to surface'",
        "contact.py --runs 1 --mesh 2.5e-3 32",
        lambda found: found["times_faster_wall"],
        "> 7.7",
        _contact_sides,
        enters=True,
    ),
    "contact_growth": Row(
        "Contact on two ranks: exponent of time over degrees of freedom",
        SIZES,
        "",
        _exponent,
        "< 1.3",
        _listed("wall", "sizes", " s"),
        enters=True,
    ),
    "contact_iterations": Row(
        "Newton iterations of contact, most over least",
        SIZES,
        "",
        _growth("iterations", "sizes"),
        "< 1.3",
        _listed("iterations", "sizes"),
        enters=True,
    ),
    "contact_memory": Row(
        "Memory of contact, GB for a million degrees of freedom, over 8",
        SIZES,
        "",
        lambda found: found["sizes"][-1]["megabytes"] * 1e3 / found["sizes"][-1]["dofs"] / 8.0,
        "< 1",
        _listed("megabytes", "sizes", " MB"),
        enters=True,
    ),
    "multigrid": Row(
        "Ten modes by multigrid: memory of the solution over that of a factorisation",
        "iterative.py --sizes 0.03 --ranks 2",
        "iterative.py --sizes 0.09 --ranks 1",
        lambda found: found["ratios"][-1]["solution_gib"],
        "< 0.33",
        _iterative_sides,
        enters=True,
    ),
    "multigrid_iterations": Row(
        "Iterations of modes without a factorisation, most over least",
        WITHOUT,
        "",
        _growth("iterations", "runs"),
        "< 1.3",
        _listed("iterations", "runs"),
        enters=True,
    ),
    "multigrid_memory": Row(
        "Memory of modes of 5 million degrees of freedom, over 20 GiB",
        WITHOUT,
        "",
        lambda found: found["runs"][-1]["process_gib"] / 20.0,
        "< 1",
        _listed("process_gib", "runs", " GiB"),
        enters=True,
    ),
    "multigrid_time": Row(
        "Time of the same, over 40 minutes",
        WITHOUT,
        "",
        lambda found: found["runs"][-1]["wall_seconds"] / 2400.0,
        "< 1",
        _listed("wall_seconds", "runs", " s"),
        enters=True,
    ),
    "gradient": Row(
        "Derivatives of all modes by all parameters of a diagnosis, over one modal solution",
        "costs.py gradient",
        "costs.py gradient --element-size 0.02 --runs 3",
        lambda found: found["gradient"]["ratio gradient / solution (median of pairs)"],
        "< 0.1",
    ),
    "patches": Row(
        "Derivatives of 20 modes by the moduli of 1,000 patches, over one modal solution",
        "costs.py patches --runs 5",
        "costs.py patches --runs 3 --cells 32 20 1 --patches 16",
        lambda found: found["patches"]["ratio of eigenvalues (median of pairs)"],
        "< 1",
        lambda found: (
            f"{found['patches']['DOFs']:,} DOFs; of their shapes at 20 sensors "
            f"{found['patches']['ratio of shapes (median of pairs)']:.2f}"
        ),
    ),
    "many": Row(
        "One iteration of an update of 1,000 moduli on 20 modes with shapes, over a modal solution",
        "updating.py many --runs 1 --cells 120 75 3",
        "updating.py many --runs 3 --cells 32 20 1 --patches 16",
        lambda found: found["many"]["ratio"],
        "< 2",
        lambda found: f"{found['many']['dofs']:,} DOFs",
    ),
    "assembly": Row(
        "K(p) and M(p) as sums of kept matrices, over their assembly",
        "costs.py assembly",
        "costs.py assembly --element-size 0.02 --runs 3",
        lambda found: found["assembly"]["ratio (median of pairs)"],
        "< 0.2",
    ),
    "updating": Row(
        "One iteration of an update on 6 modes and 50 lines of FRFs, over its modal solution",
        "updating.py cost",
        "updating.py cost --cost-size 0.045 --runs 2",
        lambda found: found["cost"]["ratio"],
        "< 2",
        lambda found: f"{found['cost']['dofs']:,} DOFs",
    ),
    "bayes": Row(
        "A modal solution over one sample of the posterior of four parameters",
        "bayes.py plates",
        "bayes.py plates --quick",
        lambda found: found["plates"]["ratio"],
        "> 500",
        lambda found: f"{found['plates']['dofs']:,} DOFs",
    ),
    "harmonic": Row(
        "Time integration to 0.5 % of the peak over harmonic balance, per frequency",
        "harmonic.py transient",
        "harmonic.py transient --coarse",
        lambda found: found["transient"]["ratio"]["wall_s"],
        "> 50",
        lambda found: f"{found['transient']['interface_points']} points of the joint",
    ),
    "ranks": Row(
        "`diagnose demos/lap_plates`, eleven torques: time on two ranks over one",
        "run.py --as diagnose",
        "",
        lambda found: found["two"]["wall"] / found["one"]["wall"],
        "< 0.6",
        lambda found: (
            f"{found['one']['wall']:.0f} s on one core and {found['two']['wall']:.0f} s on two"
        ),
        enters=True,
    ),
    "diagnose": Row(
        "The same with a kept model, on one rank: processor seconds over 20",
        "run.py --as diagnose",
        "",
        lambda found: found["kept"]["cpu"] / 20.0,
        "< 1",
        lambda found: f"{found['kept']['cpu']:.0f} s of processor, {found['kept']['wall']:.0f} s",
        enters=True,
    ),
    "commands": Row(
        "Commands on two ranks: time on one over that on two, the least of them",
        "run.py --as commands",
        "",
        lambda found: min(each["one"] / each["two"] for each in found.values()),
        "> 1.7",
        lambda found: "; ".join(
            f"{name} {each['one'] / each['two']:.2f} ({each['one']:.0f} s)"
            for name, each in found.items()
        ),
        enters=True,
    ),
    "start": Row(
        "`fenics-joints --help`: seconds over 0.3",
        "run.py --as start",
        "run.py --as start",
        lambda found: median(found["seconds"]) / 0.3,
        "< 1",
    ),
}
MEETS = {"<": lambda a, b: a <= b, ">": lambda a, b: a >= b}


def measured(command: str, enters: bool, given: str | None) -> dict:
    """The JSON of a script, with how busy the machine was with other work meanwhile."""
    script, *words = shlex.split(command)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "found.json"
        start = [sys.executable] if enters else [*launcher(given), "python3"]
        own = [*start, str(HERE / script), *words, "--json", str(out)]
        before, began = _busy(), time.perf_counter()
        spent = run(own, ROOT, threads(1))
        elapsed = time.perf_counter() - began
        other = max(_busy() - before - spent["cpu"], 0.0) / elapsed
        found = json.loads(out.read_text())
    return {"found": found, "seconds": elapsed, "other_load": round(other, 2)}


def _busy() -> float:
    """Processor seconds that this machine has worked since it started."""
    first = Path("/proc/stat").read_text().splitlines()[0].split()[1:]
    user, nice, system, _, _, irq, softirq, *_ = map(int, first)
    return (user + nice + system + irq + softirq) / os.sysconf("SC_CLK_TCK")


def diagnose(given: str | None) -> dict:
    """Whole diagnoses: on one rank, which keeps its model, on two, and on one with it kept."""
    with tempfile.TemporaryDirectory() as folder:
        words = [*launcher(given), "fenics-joints", "diagnose", "demos/lap_plates"]
        keep = [*words, "--keep", folder, "--ranks", "1"]
        run(words, ROOT, {**threads(1), "FENICS_JOINTS_RANKS": "2"})  # compiles
        sides = {"one": keep, "two": [*words, "--ranks", "2"], "kept": keep}
        return {name: run(command, ROOT, threads(1)) for name, command in sides.items()}


#: Commands that several ranks share, with models that take some half a minute.
SHARED = {
    "modes": "modes demos/engraving_machine --set mesh.element_size='45 mm'",
    "preload": "preload demos/half_lap_beam/contact.toml --set mesh.n_lap=40 --set mesh.n_width=10",
    "harmonic": "harmonic demos/half_lap_beam/slipping.toml",
    "sweep": "database sweep --bolt M12 --force '20, 35, 50 kN' --thickness '10, 15, 20, 25 mm'",
    "posterior": "update demos/bolted_beams --bayes",
}


def commands(given: str | None) -> dict:
    """Each of `SHARED` on one rank and on two; before, on one to compile."""
    found = {}
    for name, words in SHARED.items():
        with tempfile.TemporaryDirectory() as folder:

            def once(ranks: int, at: str, words=words, folder=folder) -> float:
                own = [*launcher(given), "fenics-joints", *shlex.split(words)]
                own += ["--db", str(Path(folder) / at)] if "sweep" in own else []
                return run([*own, "--ranks", str(ranks)], ROOT, threads(1))["wall"]

            once(1, "compiles.db")
            found[name] = {"one": once(1, "one.db"), "two": once(2, "two.db")}
    return found


def start(given: str | None) -> dict:
    """Ten starts of the command, from within FEniCSx' environment."""
    command = ["fenics-joints", "--help"]
    return {"seconds": [run(command, ROOT, threads(1))["wall"] for _ in range(10)]}


ROLES = {"diagnose": diagnose, "commands": commands, "start": start}


def table(results: dict) -> str:
    """The table in Markdown."""
    text = "| what | measured | target | details | other work | on |\n|---|---|---|---|---|---|\n"
    machines: list[str] = []
    for name, row in ROWS.items():
        found = results["rows"].get(name)
        if found is None:
            text += f"| {row.what} | not run | {row.target} | | | |\n"
            continue
        if found["machine"] not in machines:
            machines.append(found["machine"])
        missed = "" if found["meets"] else " (missed)"
        text += (
            f"| {row.what} | {found['number']:.3g}{missed} | {row.target} | {found['detail']} | "
            f"{found['other_load']:.1f} | {found['date']}, {found['commit']}, "
            f"machine {machines.index(found['machine']) + 1} |\n"
        )
    named = "; ".join(f"machine {i}: {name}" for i, name in enumerate(machines, 1))
    return f"{text}\nOther work in processors' loads. {named[:1].upper()}{named[1:]}.\n"


def machine() -> str:
    """What the machine is, in words."""
    text = Path("/proc/cpuinfo").read_text()
    said = [re.findall(rf"^{key}\s*:\s*(.*)$", text, re.M) for key in ("model name", "cpu family")]
    name, family = (each[0] if each else platform.machine() for each in said)
    return f"{os.cpu_count()} cores, {name} (family {family})"


def commit() -> str:
    """The commit that is measured."""
    asks = ["git", "rev-parse", "--short", "HEAD"]
    try:
        return subprocess.run(asks, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    except FileNotFoundError:
        return "unknown commit"


def main() -> None:
    made = parser(__doc__)
    made.add_argument("rows", nargs="*", metavar="NAME", help=f"{', '.join(ROWS)}; all by default")
    made.add_argument("--quick", action="store_true", help="small models, in some minutes")
    made.add_argument("--write", action="store_true", help="put the table into docs/speed.md")
    made.add_argument("--launcher", help="command that enters FEniCSx; '' for none")
    made.add_argument("--as", dest="role", choices=ROLES, help="measure this alone")
    arguments = made.parse_args()
    if unknown := set(arguments.rows) - set(ROWS):
        made.error(f"no row {sorted(unknown)[0]!r}: expected {', '.join(ROWS)}")
    if arguments.role:
        write(arguments.json, ROLES[arguments.role](arguments.launcher))
        return
    kept = HERE / ("quick.json" if arguments.quick else "results.json")
    results = json.loads(kept.read_text()) if kept.exists() else {"rows": {}}
    done: dict[str, dict] = {}
    for name in arguments.rows or ROWS:
        row = ROWS[name]
        command = row.quick if arguments.quick else row.command
        if not command:
            continue
        if command not in done:
            print(f"{command} ...", flush=True)
            done[command] = measured(command, row.enters, arguments.launcher)
        one = done[command]
        try:
            number = row.number(one["found"])
        except KeyError as missing:
            print(f"{row.what}: not compared, {missing} is not there", flush=True)
            continue
        sign, limit = row.target.split()
        results["rows"][name] = {
            "number": number,
            "target": row.target,
            "meets": MEETS[sign](number, float(limit)),
            "detail": row.detail(one["found"]),
            "seconds": round(one["seconds"], 1),
            "other_load": one["other_load"],
            "date": date.today().isoformat(),
            "commit": commit(),
            "machine": machine(),
            "command": command,
        }
        kept.write_text(json.dumps(results, indent=2) + "\n")
        print(f"{row.what}: {number:.3g} ({row.target}), {one['seconds']:.0f} s", flush=True)
    print(table(results))
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n")
    if arguments.write:
        put("table", f"\n{table(results)}\n")
        if "ranks" in results["rows"]:
            put("time", results["rows"]["ranks"]["detail"])


def put(mark: str, text: str) -> None:
    """Replace what stands in a page between a mark of this script and the next ``<!-- end -->``."""
    page = PAGES[mark]
    old = page.read_text(encoding="utf-8")
    between = re.compile(rf"(<!-- {mark}: benchmarks/run.py -->\n?).*?(?=<!-- end -->)", re.DOTALL)
    page.write_text(between.sub(lambda found: found[1] + text, old), encoding="utf-8")


if __name__ == "__main__":
    main()
