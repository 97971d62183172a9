#!/usr/bin/env python3
"""Numbers that must not move: of demos, of scripts in README and documentation, of blind cases.

    python3 tests/frozen.py [NAME ...]     compare with `frozen.json`; exit status 1 if one moved
    python3 tests/frozen.py --quick        compare a part, in minutes, as `.ci/run` does
    python3 tests/frozen.py --make         compute and write what the table lacks; '*' for all
    python3 tests/frozen.py --list         show the entries, and the seconds that each took

Each number stands in the table with what it may move by and why. Numbers of a command are known by
their place in what ``--json`` writes; printed ones by their order, so that words around them are
free. A name may be a pattern, as ``'blind*'``; with ``--make`` it makes what it names again.

What was computed is kept in ``build/frozen`` under a digest of all sources: a run that was stopped
goes on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = Path(__file__).with_name("frozen.json")
#: Forty opened cases: of each geometry and kind, drawn from the fast ones in which a recorded
#: diagnosis saw something wrong, if anything was.
CHOICE = Path(__file__).with_name("frozen_cases.json")
CHECKS = ROOT / "benchmarks" / "blind" / "checks"
#: Command that the environment of DOLFINx is entered with.
LAUNCHER = ROOT / "with-fenicsx"
_MPI = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}

#: What a number may move by: a share of it, an amount, and why; if printed, by its last digit too.
REASONS = {
    "exact": (0.0, 0.0, "a word or a count"),
    "solver": (1e-5, 0.0, "solvers end at 1e-8 to 1e-10, and BLAS differs by processor"),
    "mesh": (2e-3, 0.0, "gmsh's free meshes differ from version to version"),
    "fit": (5e-4, 0.0, "fits end at a tolerance, on reduced models that err by 1e-4"),
    "deviation": (0.05, 0.0, "a standard deviation, a misfit, a count at an edge: differences"),
    "interval": (2e-3, 0.0, "a fitted number moves by a tenth of its deviation, too"),
    "sampling": (0.15, 0.0, "drawn: the order of draws is no promise, their spread is"),
    "probability": (0.0, 0.03, "evidence is approximate: 0.1 of its logarithm moves 0.5 by 0.03"),
}
#: Least probability of what is looked at in a diagnosis.
LEAST = 0.05
#: The same of a hypothesis whose numbers are frozen: not one that might be gone the next time.
SURE = 0.15

# -- what is frozen --------------------------------------------------------------------------------

#: Of printed numbers: by default those of a fit.
PRINTED = {
    "demo_bayes": "sampling",
    "demo_random_field": "sampling",
    "demo_bolted_beams": "sampling",
    "demo_cad_bracket": "mesh",
    "demo_diagnosis": "deviation",
    "demo_lap_plates": "deviation",
}
#: Scripts of the pages: a page, and what only one of its blocks has.
PAGES = {
    "forms": "uncoupled_layer",
    "preload": "solve_preload(",
    "slip": "solve_quasi_static(",
    "functions": "shape_gradients(",
    "beams": "BeamStructure(",
}
#: Pages that print derivatives of shapes, whose sign is the solver's choice.
SIGN_FREE = ("docs/functions.md",)
#: By command: which places of its JSON are frozen, and why each may move; the first that fits.
PLACES = {
    "modes": [
        (r"rigid_body_modes", "exact"),
        (r"frequencies_hz\[\d+\]|test\.gap|test\.pairs\.[^.]+\.(model_hz|mac)", "solver"),
    ],
    "preload": [
        (r"contacts\.[^.]+\.(open|slip|stick)", "deviation"),
        (r"frequencies_hz\..*|bolt_forces_n\..*|contacts\.[^.]+\.(?!area_above).*", "solver"),
    ],
    "update": [
        (r"parameters\.[^.]+\.determined|fit\.(converged|degrees_of_freedom)", "exact"),
        (r"parameters\.[^.]+\.value", "interval"),
        (r"\w+\.[^.]+\.minimum\.(cutoff_pa|objective)|curve_gap\..*", "deviation"),
        (r"\w+\.[^.]+\.minimum\.frequencies_hz.*", "fit"),
        (r"parameters\.[^.]+\.relative_standard_deviation", "deviation"),
        (r"modes\.[^.]+\.before_hz", "solver"),
        (r"modes\.[^.]+\.(after_hz|mac_after)|held_modes\.[^.]+\.predicted_hz", "fit"),
    ],
    "harmonic": [
        (r"frequencies_at_rest_hz.*", "solver"),
        (r"levels[.\[][^.]+\.(peak|peak_hz|peak_displacement_m)", "fit"),
        (r"levels[.\[][^.]+\.(damping_ratio|joint_energy_j)", "fit"),
        (r"identified[.\[][^.]+\.(values\..*|objective)", "deviation"),
    ],
    "diagnose": [
        (r"verdict", "exact"),
        (r"gap\.(before|noise)", "fit"),
        (r"gap\.(after|heldout_before|heldout_after|placebo_after)", "deviation"),
        (r"probability\..*", "probability"),
        (r"identified\..*\.(value|low|high)", "interval"),
    ],
}
#: Where a list's members have their name.
NAMES = ("name", "label", "effect", "level_n", "level", "method", "scheme")
#: What CI compares.
QUICK = (
    "README.md",
    "docs/forms.md",
    "demo_bolted_plates",
    "modes demos/dumbbell",
    "update demos/dumbbell",
)
#: How many of the blind cases CI compares: the fastest in which a cause was seen.
QUICK_CASES = 2
#: Not this one: the fit of its pair has two optima of like evidence, and the processor chooses (an
#: AMD EPYC takes the other one; verdict and probabilities are the same).
TWO_OPTIMA = "349de622"


@dataclass(frozen=True)
class Entry:
    """What one process computes.

    Attributes:
        name: Its name in the table.
        arguments: Python's, from the repository; ``{json}`` stands for the file to be written.
        kind: A command's name, or the reason why printed numbers may move.
        make: Called with the scratch folder before; what it returns is added to the arguments.
        seconds: What it took once.
        quick: Whether CI compares it.
        model: The reduced model that it shares with others; the first one makes it.
    """

    name: str
    arguments: list[str]
    kind: str
    make: Callable[[Path], list[str]] | None = None
    seconds: float = 60.0
    quick: bool = False
    model: str = ""


def entries(table: dict) -> list[Entry]:
    """All of them, in a fixed order."""
    found = [Entry(d.stem, [str(d)], PRINTED.get(d.stem, "fit")) for d in _demos()]
    found += [Entry("README.md", [], "solver", _readme)]
    found += [Entry(f"docs/{page}.md", [], "fit", _page(page)) for page in PAGES]
    found += [Entry(f"{c} {case}", [*_command(c), case], c) for c, case in _commands()]
    cases = json.loads(CHOICE.read_text(encoding="utf-8")) if CHOICE.exists() else []
    by_time = sorted(cases, key=lambda case: case["seconds"])
    quick = [case["id"] for case in by_time if case["said"] == "cause"][:QUICK_CASES]
    quick = [name for name in quick if name != TWO_OPTIMA]
    for case in cases:
        place = Entry(
            f"blind {case['id']}, {case['geometry']}, {case['kind']}",
            _command("diagnose"),
            "diagnose",
            _blind(case),
            case["seconds"],
            case["id"] in quick,
            case["geometry"],
        )
        found.append(place)
    kept = table["entries"]
    for i, e in enumerate(found):
        # Blind cases keep the recorded seconds: their order, and so who makes the model, is fixed.
        spent = kept[e.name]["seconds"] if e.name in kept and not e.model else e.seconds
        found[i] = replace(e, seconds=spent, quick=e.quick or e.name in QUICK)
    return found


def _demos() -> list[Path]:
    return sorted(d.relative_to(ROOT) for d in ROOT.glob("demos/*/demo_*.py"))


def _command(command: str) -> list[str]:
    return ["-m", "fenics_joints", command, "--json", "{json}"]


def _commands() -> list[tuple[str, str]]:
    """The commands that README and the demos' pages show, but for those that sample for hours."""
    pages = [ROOT / "README.md", *sorted(ROOT.glob("demos/*/README.md"))]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    words = "|".join(PLACES)
    shown = re.findall(rf"^\./with-fenicsx fenics-joints ({words}) (demos/\S+)", text, re.MULTILINE)
    quick = [("modes", "demos/dumbbell"), ("modes", "demos/lap_beam"), ("modes", "demos/c_beam")]
    return list(dict.fromkeys([*quick, *shown]))


def _blocks(page: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def _script(folder: Path, text: str) -> list[str]:
    path = folder / "script.py"
    path.write_text(text, encoding="utf-8")
    return [str(path)]


def _readme(folder: Path) -> list[str]:
    """README's form, with the lift by hand that its longer version in the documentation has."""
    (whole,) = [b for b in _blocks("docs/forms.md") if PAGES["forms"] in b]
    (short,) = [b for b in _blocks("README.md") if PAGES["forms"] in b]
    start, lift = short.split("K.assemble()")[0], whole.split("K.assemble()")[1]
    return _script(folder, f"import numpy as np\n{start}K.assemble()\n{lift}")


def _page(page: str) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (text,) = [b for b in _blocks(f"docs/{page}.md") if PAGES[page] in b]
        return _script(folder, text)

    return make


def _blind(case: dict) -> Callable[[Path], list[str]]:
    """A case out of its archive; a reduced model serves all cases of a geometry."""

    def make(folder: Path) -> list[str]:
        inside = f"{case['check']}/cases/{case['id']}"
        with tarfile.open(CHECKS / f"{case['check']}.tar.xz") as archive:
            members = [m for m in archive if m.name.startswith(f"{inside}/")]
            archive.extractall(folder, members, filter="data")
        return [str(folder / inside), "--keep", str(_work() / "models" / case["geometry"])]

    return make


# -- computing -------------------------------------------------------------------------------------


@cache
def _work() -> Path:
    """Folder of the results that were computed with these sources."""
    total = hashlib.sha256()
    rooms = [ROOT / room for room in ("fenics_joints", "forms", "meshes", "demos", "docs")]
    kinds = (".py", ".c", ".toml", ".csv", ".md", ".step")
    inside = [p for room in rooms for p in room.rglob("*") if p.suffix in kinds]
    for path in sorted([ROOT / "README.md", *inside]):
        total.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return ROOT / "build" / "frozen" / total.hexdigest()[:12]


def compute(entry: Entry, seconds: float) -> dict:
    """Run it; ``{"seconds", "said"}`` with what it printed or wrote, or ``{"error"}``."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        out, started = folder / "out.json", time.monotonic()
        arguments = [a.replace("{json}", str(out)) for a in entry.arguments]
        arguments += entry.make(folder) if entry.make else []
        try:
            done = subprocess.run(
                [sys.executable, *arguments],
                cwd=ROOT,
                stdin=subprocess.DEVNULL,
                timeout=seconds,
                capture_output=True,
                text=True,
                env={**os.environ, **_MPI, "OMP_NUM_THREADS": "1", "FENICS_JOINTS_RANKS": "1"},
            )
        except subprocess.TimeoutExpired:
            return {"error": f"stopped after {seconds:.0f} s"}
        spent = round(time.monotonic() - started, 1)
        if done.returncode:
            return {"error": f"exit status {done.returncode}: {done.stderr.strip()[-1000:]}"}
        said = done.stdout
        if entry.kind in PLACES:
            said = json.loads(out.read_text(encoding="utf-8"))
    return {"seconds": spent, "said": said}


def numbers(entry: Entry, said, least: float = LEAST) -> list[list]:
    """``[label, value, may move by, why]`` of each number that it printed or wrote."""
    if entry.kind in PLACES:
        return of_json(entry.kind, said, least)
    return printed(said.replace("-", "") if entry.name in SIGN_FREE else said, entry.kind)


def printed(text: str, why: str) -> list[list]:
    """Those of a text, in its order.

    A printed number may move by one unit of its last digit, too.
    """
    found, heading = [], ""
    for line in text.splitlines():
        label = re.sub(r"\s+", " ", re.sub(NUMBER, "#", line)).strip()[:80]
        heading = label if re.search(r"[^\W\d_]", label) else heading
        label = label if label == heading else f"{heading[:60]} / {label}"[:80]
        for digits in re.findall(NUMBER, line):
            whole, _, power = digits.replace(",", "").replace("−", "-").lower().partition("e")
            last = 10.0 ** (int(power or 0) - len(whole.partition(".")[2]))
            value = float(whole) * 10.0 ** int(power or 0)
            found.append([label, value, _short(max(last, REASONS[why][0] * abs(value))), why])
    return found


#: A number that is not part of a name, as the 10 of M10.
NUMBER = r"(?<![\w.,])[-+−]?\d+(?:,\d{3})*(?:\.\d+)?(?:[eE][-+]?\d+)?(?!\w)"


def of_json(command: str, content: dict, least: float = LEAST) -> list[list]:
    """Those of a command's JSON; their labels are their places."""
    if command == "diagnose":
        content = _diagnosis(content, least)
    if command == "harmonic":  # those of rigid motions are round-off
        hz = content["frequencies_at_rest_hz"]
        content = content | {"frequencies_at_rest_hz": [f for f in hz if f > 1e-3 * max(hz)]}
    places = [(re.compile(pattern), why) for pattern, why in PLACES[command]]
    flat = dict(_flat(content))
    found = []
    for place, value in flat.items():
        why = next((why for pattern, why in places if pattern.fullmatch(place)), None)
        if why is None:
            continue
        if isinstance(value, str | bool | None):
            found.append([place, value, 0.0, "exact"])
            continue
        share, amount, _ = REASONS[why]
        may = max(share * abs(value), amount)
        if why == "interval":
            base, _, kind = place.rpartition(".")
            may = max(may, (0.1 if kind == "value" else 0.3) * _deviation(flat, base))
        found.append([place, _short(value, 9), _short(may), why])
    return found


def _deviation(flat: dict, base: str) -> float:
    """A number's stated standard deviation, or a quarter of its interval."""
    if f"{base}.low" in flat:
        return abs(flat[f"{base}.high"] - flat[f"{base}.low"]) / 4
    relative = flat.get(f"{base}.relative_standard_deviation") or 0.0
    return abs(flat[f"{base}.value"]) * min(relative, 10.0)


def _diagnosis(content: dict, least: float) -> dict:
    """What is frozen of a diagnosis: verdict, gap, effects and numbers of likely hypotheses."""
    effects = {
        f"{e['name']} ({e['region']})" if e["region"] else e["name"]: e["probability"]
        for e in content["effects"]
    }
    sums: dict[str, float] = {}
    for e in content["effects"]:
        sums[e["class"]] = sums.get(e["class"], 0.0) + e["probability"]
    return {
        "verdict": content["verdict"],
        "gap": content["gap"],
        "probability": {
            "of effect": {k: v for k, v in effects.items() if v >= LEAST},
            "of class": {k: min(v, 1.0) for k, v in sums.items() if v >= LEAST},
        },
        "identified": {
            h["label"]: {
                f"{p['effect']}, {p['name']}": {k: p[k] for k in ("value", "low", "high")}
                for p in h["parameters"]
                if not p["nuisance"]
            }
            for h in content["hypotheses"]
            if h["probability"] >= least
        },
    }


def _flat(content: object, place: str = "") -> Iterator[tuple[str, object]]:
    """Numbers and words by their places, members of lists by their names where they have some."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from _flat(value, f"{place}.{key}" if place else str(key))
    elif isinstance(content, list):
        heads = [
            next((str(value[n]) for n in NAMES if n in value), None)
            if isinstance(value, dict)
            else None
            for value in content
        ]
        for i, (value, head) in enumerate(zip(content, heads, strict=True)):
            alone = head is not None and heads.count(head) == 1
            name = f".{head.replace('.', '_')}" if alone else f"[{i}]"
            yield from _flat(value, place + name)
    else:
        yield place, content


def _short(value: float, digits: int = 3) -> float:
    return float(f"{value:.{digits}g}")


# -- comparing -------------------------------------------------------------------------------------


def moved(kept: list[list], found: list[list], by_name: bool) -> list[str]:
    """A line for each kept number that is not among the new ones."""
    lines = []
    if by_name:
        now = {row[0]: row for row in found}
        for label, value, may, why in kept:
            gone = label not in now
            # What is too improbable to be listed is as good as 0.
            if gone and why == "probability" and value - may <= LEAST:
                continue
            if gone or not _agree([label, value, may, why], now[label]):
                lines.append(_line(label, value, may, why, None if gone else now[label][1]))
        new = [r for r in found if r[3] == "probability" and r[1] - r[2] > LEAST]
        known = {row[0] for row in kept}
        lines += [f"{r[0]}: {r[1]:.3g}, not among those kept" for r in new if r[0] not in known]
        return lines
    for old, new in _unmatched(kept, found):
        for i, (label, value, may, why) in enumerate(old):
            lines.append(_line(label, value, may, why, new[i][1] if len(new) == len(old) else None))
    return lines


def _line(label, value, may, why, now) -> str:
    is_now = "is gone" if now is None else f"is {now if isinstance(now, str) else f'{now:.6g}'}"
    was = f"{value:.6g}, may move by {may:g} ({why})" if isinstance(value, float) else repr(value)
    return f"{label}: {is_now}, was {was}"


def _agree(kept: list, now: list) -> bool:
    if isinstance(kept[1], str | bool | None) or isinstance(now[1], str | bool | None):
        return kept[1] == now[1]
    return abs(kept[1] - now[1]) <= kept[2] * (1 + 1e-9) + 1e-300


def _unmatched(kept: list[list], found: list[list]) -> Iterator[tuple[list, list]]:
    """Parts in which two sequences differ, by their longest common subsequence."""
    n, m = len(kept), len(found)
    best = [[0] * (m + 1) for _ in range(n + 1)]
    for i in reversed(range(n)):
        for j in reversed(range(m)):
            same = best[i + 1][j + 1] + 1 if _agree(kept[i], found[j]) else 0
            best[i][j] = max(same, best[i + 1][j], best[i][j + 1])
    i = j = 0
    old: list = []
    new: list = []
    while i < n or j < m:
        if i < n and j < m and _agree(kept[i], found[j]) and best[i][j] == best[i + 1][j + 1] + 1:
            if old:
                yield old, new
            old, new = [], []
            i, j = i + 1, j + 1
        elif j == m or (i < n and best[i + 1][j] >= best[i][j + 1]):
            old, i = [*old, kept[i]], i + 1
        else:
            new, j = [*new, found[j]], j + 1
    if old:
        yield old, new


# -- the command -----------------------------------------------------------------------------------


@dataclass
class Run:
    """Computes entries in parallel until the time is over."""

    jobs: int
    minutes: float
    again: bool
    started: float = field(default_factory=time.monotonic)

    def __call__(self, todo: list[Entry]) -> Iterator[tuple[Entry, dict]]:
        """Yield entries with their results as they become ready, and none when time is over."""
        place, locks = _work(), defaultdict(threading.Lock)
        place.mkdir(parents=True, exist_ok=True)

        def one(entry: Entry) -> dict | None:
            file = place / f"{hashlib.sha256(entry.name.encode()).hexdigest()[:16]}.json"
            if file.exists() and not self.again:
                return json.loads(file.read_text(encoding="utf-8"))
            left = 60 * self.minutes - (time.monotonic() - self.started)
            if left < min(entry.seconds, 60 * self.minutes / 2):
                return None
            wait = entry.model and not any((place / "models" / entry.model).glob("*"))
            with locks[entry.model] if wait else nullcontext():
                found = compute(entry, max(left, 60.0))
            if "error" not in found:
                file.write_text(json.dumps(found), encoding="utf-8")
            return found

        # The longest first, so that no process waits for another at the end.
        with ThreadPoolExecutor(self.jobs) as pool:
            todo = sorted(todo, key=lambda e: -e.seconds)
            running = {pool.submit(one, entry): entry for entry in todo}
            for future in as_completed(running):
                found = future.result()
                if found is not None:
                    yield running[future], found


def write(table: dict) -> None:
    """One number a line, so that a change of the table can be read."""
    text = ['{"reasons": {']
    text += [",\n".join(f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in table["reasons"].items())]
    text += ['},\n"entries": {']
    parts = []
    for name in sorted(table["entries"]):
        entry = table["entries"][name]
        rows = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in entry["numbers"])
        head = {k: v for k, v in entry.items() if k != "numbers"}
        head = json.dumps(head, ensure_ascii=False)[1:-1]
        name = json.dumps(name, ensure_ascii=False)
        parts.append(f' {name}: {{{head}, "numbers": [\n{rows}\n ]}}')
    text += [",\n".join(parts), "}}", ""]
    new = TABLE.with_suffix(".new")
    new.write_text("\n".join(text), encoding="utf-8")
    json.loads(new.read_text(encoding="utf-8"))
    new.replace(TABLE)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="entries, or patterns of their names")
    parser.add_argument("--quick", action="store_true", help="only what CI compares")
    parser.add_argument("--make", action="store_true", help="write the table")
    parser.add_argument("--list", action="store_true", help="show the entries; run nothing")
    parser.add_argument("--again", action="store_true", help="use nothing that was kept")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time [1]")
    parser.add_argument("--minutes", type=float, default=600.0, help="time that it may take [600]")
    asked = parser.parse_args()
    if importlib.util.find_spec("dolfinx") is None and not asked.list:
        os.execv(LAUNCHER, [str(LAUNCHER), "python3", *sys.argv])
    table = {"entries": {}}
    if TABLE.exists():
        table = json.loads(TABLE.read_text(encoding="utf-8"))
    table["reasons"] = {
        why: {"share": share, "amount": amount, "why": text}
        for why, (share, amount, text) in REASONS.items()
    }
    everything = entries(table)
    todo = [e for e in everything if e.quick or not asked.quick]
    if asked.names:
        todo = [e for e in todo if any(fnmatch(e.name, name) for name in asked.names)]
    kept = table["entries"]
    if asked.list:
        for e in todo:
            words = f"{len(kept[e.name]['numbers'])} numbers" if e.name in kept else "not made"
            print(f"{e.seconds:7.0f} s  {'quick' if e.quick else '     '}  {e.name}: {words}")
        print(f"{sum(e.seconds for e in todo):7.0f} s in all")
        return 0
    if asked.make:
        for name in set(kept) - {e.name for e in everything}:
            del kept[name]
        todo = [e for e in todo if asked.names or asked.again or e.name not in kept]
    if asked.again:  # they hold finished fits, too
        shutil.rmtree(_work() / "models", ignore_errors=True)
    bad, done = 0, set()
    for entry, found in Run(asked.jobs, asked.minutes, asked.again)(todo):
        done.add(entry.name)
        if "error" in found:
            bad += 1
            print(f"{entry.name}: FAILED, {found['error']}", flush=True)
        elif asked.make:
            by = "name" if entry.kind in PLACES else "order"
            rows, spent = numbers(entry, found["said"], SURE), found["seconds"]
            kept[entry.name] = {
                "seconds": spent,
                "sources": _work().name,
                "by": by,
                "numbers": rows,
            }
            write(table)
            print(f"{entry.name}: {len(rows)} numbers in {spent} s", flush=True)
        elif entry.name not in kept:
            print(f"{entry.name}: not in the table; --make puts it there", flush=True)
        else:
            old = kept[entry.name]
            lines = moved(old["numbers"], numbers(entry, found["said"]), old["by"] == "name")
            bad += len(lines)
            print(f"{entry.name}: {len(lines)} of {len(old['numbers'])} moved", flush=True)
            print("".join(f"  {line}\n" for line in lines), end="", flush=True)
    late = [e.name for e in todo if e.name not in done]
    if late:
        print(f"no time left for: {', '.join(late)}")
    good = "made" if asked.make else "nothing moved"
    print(f"{bad} numbers moved or runs failed" if bad else good, flush=True)
    return 1 if bad or (late and not asked.make) else 0


if __name__ == "__main__":
    sys.exit(main())
