"""Matrices of CalculiX in a diagnosis, against tests by CalculiX of the same two plates.

    python3 benchmarks/matrices.py [--folder FOLDER] [--json FILE]

Two plates of aluminium, 200 by 60 by 6 mm, lap by 60 mm under two bolts. Each is exported by
CalculiX alone, as solids (C3D20) and as shells (S8). The tests are of one CalculiX model in which a
layer, 0.01 mm thin, joins them: stiff, soft along and across, or soft around bolt 2, with 0.05 % of
noise on frequencies and 1 % on shapes. Needs nothing but Python itself where it is started: our
side runs through ``./with-fenicsx`` when DOLFINx is not at hand, CalculiX where ``ccx`` is.
"""

from __future__ import annotations

import itertools
import json
import math
import random
import subprocess
import tempfile
from pathlib import Path

from harness import launcher, parser, run, threads, write

LENGTH, LAP, WIDTH, THICK, LAYER = 0.2, 0.06, 0.06, 0.006, 1e-5
E, NU, RHO = 7e10, 0.33, 2700.0
CELLS = (20, 8)
STEP = "*STEP\n*FREQUENCY{}\n{}\n{}*END STEP\n"
CORNERS = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)]
MIDDLES = [(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)]
MIDDLES += [(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)]
#: Stiffness per area across, Pa/m, of the layer's two halves; along it is a half of that.
TESTS = {"nothing": (1e15, 1e15), "soft joint": (1e11, 1e11), "bolt 2 loose": (1e13, 5e10)}
BOLTS = '[["170 mm", "15 mm", "6 mm"], ["170 mm", "45 mm", "6 mm"]]'
#: Where both plates are measured, along x and on their upper faces, m.
SEEN = [(0, 6), (40, 6), (80, 6), (120, 6), (160, 12), (200, 12), (240, 12), (280, 12), (340, 12)]


def block(counts, low, high, shell=False):
    """Nodes, (n, 4) with their numbers, and elements of second order in a box."""
    sizes = [2 * n + 1 for n in counts]
    sizes[2] = 1 if shell else sizes[2]
    number, nodes = {}, []
    for k, j, i in itertools.product(*(range(n) for n in reversed(sizes))):
        if (i % 2) + (j % 2) + (k % 2) < 2:
            number[i, j, k] = len(number) + 1
            at = [
                a + (b - a) * p / max(n - 1, 1)
                for a, b, p, n in zip(low, high, (i, j, k), sizes, strict=True)
            ]
            nodes.append((number[i, j, k], *at))
    wanted = CORNERS[:4] + MIDDLES[:4] if shell else CORNERS + MIDDLES
    elements = [
        [number[2 * i + a, 2 * j + b, 2 * k + c] for a, b, c in wanted]
        for k, j, i in itertools.product(*(range(n) for n in reversed(counts)))
    ]
    return nodes, elements


def deck(blocks, step: str, shell=False) -> str:
    """A deck of blocks (nodes, elements, E, nu, rho), whose nodes are one where they meet."""
    place, lines, elements = {}, [], 0
    for b, (nodes, cells, modulus, nu, rho) in enumerate(blocks):
        own, kind = {}, "S8" if shell else "C3D20"
        lines.append(f"*NODE, NSET=N{b}")
        for node, *x in nodes:
            key = tuple(round(1e8 * c) for c in x)
            if key not in place:
                place[key] = len(place) + 1
                lines.append(f"{place[key]}, " + ", ".join(f"{c:.12g}" for c in x))
            own[node] = place[key]
        lines.append(f"*ELEMENT, TYPE={kind}, ELSET=E{b}")
        for cell in cells:
            elements += 1
            named = [str(own[node]) for node in cell]
            lines.append(f"{elements}, " + ", ".join(named[:10]) + ("," if named[10:] else ""))
            lines += [", ".join(named[10:])] if named[10:] else []
        lines += [f"*MATERIAL, NAME=M{b}", "*ELASTIC", f"{modulus}, {nu}", "*DENSITY", f"{rho}"]
        section = "SHELL" if shell else "SOLID"
        lines.append(f"*{section} SECTION, ELSET=E{b}, MATERIAL=M{b}")
        lines += [f"{THICK}"] if shell else []
    return "\n".join(lines) + "\n" + step


def calculix(folder: Path, name: str, text: str) -> None:
    (folder / f"{name}.inp").write_text(text, encoding="ascii")
    subprocess.run(["ccx", name], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def frequencies(folder: Path, name: str) -> list[float]:
    table = (folder / f"{name}.dat").read_text(encoding="ascii").split("P A R T I C")[0]
    rows = [line.split() for line in table.splitlines()]
    return [float(row[3]) for row in rows if len(row) == 5 and row[0].isdigit()]


def displacements(folder: Path, name: str, nodes) -> list[dict[int, list[float]]]:
    """Of each mode, by node."""
    found, inside = [], False
    for line in (folder / f"{name}.frd").read_text(encoding="ascii").splitlines():
        if line.startswith(" -4"):
            inside = line.startswith(" -4  DISP")
            found += [{}] if inside else []
        elif line.startswith(" -3"):
            inside = False
        elif inside and line.startswith(" -1") and int(line[3:13]) in nodes:
            found[-1][int(line[3:13])] = [float(line[13 + 12 * c : 25 + 12 * c]) for c in range(3)]
    return found


def plates(gap=0.0, shell=False):
    low, high = (0.0, 0.0), (LENGTH, WIDTH)
    z = (THICK / 2, 1.5 * THICK) if shell else (0.0, THICK)
    ends = [
        (low, high, z[0], z[0] if shell else THICK),
        (
            (LENGTH - LAP, 0.0),
            (2 * LENGTH - LAP, WIDTH),
            z[1] + gap,
            z[1] + gap + (0 if shell else THICK),
        ),
    ]
    return [
        (*block((*CELLS, 1), (*a, bottom), (*b, top), shell), E, NU, RHO)
        for a, b, bottom, top in ends
    ]


def measured(folder: Path, name: str, halves) -> list[float]:
    """Write the test of a layer's stiffness; returns all its elastic frequencies, Hz."""
    whole = plates(LAYER)
    for half, k in enumerate(halves):
        low = (LENGTH - LAP, half * WIDTH / 2, THICK)
        high = (LENGTH, (half + 1) * WIDTH / 2, THICK + LAYER)
        layer = block((6, 4, 1), low, high)
        whole.append((*layer, k * LAYER, 0.0, 1.0))
    job = name.replace(" ", "_")
    calculix(folder, job, deck(whole, STEP.format("", 16, "*NODE FILE\nU\n")))
    places = {}
    for nodes, *_ in whole[:2]:
        places |= {tuple(round(1e6 * c) for c in x): x for _, *x in nodes}
    numbers, count = {}, 0
    for line in (folder / f"{job}.inp").read_text(encoding="ascii").splitlines():
        if line.startswith("*"):
            count = line.startswith("*NODE, N")
        elif count:
            node, *x = line.split(",")
            numbers[int(node)] = [float(c) for c in x]
    wanted = [
        (1e-3 * x, y, 1e-3 * z + (LAYER if z > 6 else 0))
        for x, z in SEEN
        for y in (0.0, WIDTH / 2, WIDTH)
    ]
    at = [min(numbers, key=lambda n, w=w: math.dist(numbers[n], w)) for w in wanted]
    hz, modes = frequencies(folder, job)[6:], displacements(folder, job, set(at))[6:]
    rng, shown = random.Random(3), []
    for f, mode in zip(hz, modes, strict=True):
        size = [max(abs(mode[n][c]) for n in at) for c in range(3)]
        if size[2] > 0.5 * max(size[:2]):  # the sensors look along z
            shown.append((f * (1 + 5e-4 * rng.gauss(0, 1)), [mode[n][2] / size[2] for n in at]))
    shown = shown[:9]
    head = ",".join(f"mode {i + 1} [Hz]" for i in range(len(shown)))
    rows = [head, ",".join(f"{f:.4f}" for f, _ in shown)]
    (folder / f"{job}_hz.csv").write_text("\n".join(rows) + "\n", encoding="ascii")
    rows = [",".join(f"mode {i + 1}" for i in range(len(shown)))]
    rows += [
        ",".join(f"{s[i] + 0.01 * rng.gauss(0, 1):.5f}" for _, s in shown) for i in range(len(at))
    ]
    (folder / f"{job}_shapes.csv").write_text("\n".join(rows) + "\n", encoding="ascii")
    return hz


def case(folder: Path, name: str, kind: str, test: str | None) -> Path:
    """The case of one kind of matrices, with a test."""
    text = [f'title = "{name}"', "[mesh.interfaces.lap]", 'between = ["a", "b"]']
    for part in "ab":
        file = f"{kind}_{part}"
        text += [f"[mesh.matrices.{part}]", f'stiffness = "{file}.sti"', f'mass = "{file}.mas"']
        text += [f'dofs = "{file}.dof"', f'nodes = "{file}.inp"']
        text += [f"thickness = {THICK}"] if kind == "shells" else []
    text += ["[parts.plates]", 'cells = ["a", "b"]', f"E = {E}", f"nu = {NU}", f"rho = {RHO}"]
    text += ["[joints.lap]", 'cells = "lap"', 'law = "springs"', "k_n = 1e13", "k_t = 5e12"]
    text.append(f"bolts = {BOLTS}")
    if test is not None:
        job = test.replace(" ", "_")
        points = [[f"{x} mm", f"{y} mm", f"{z} mm"] for x, z in SEEN for y in (0, 30, 60)]
        text += ["[test]", f'frequencies = "{job}_hz.csv"', f'shapes = "{job}_shapes.csv"']
        text += ['noise = "0.05 %"', 'shape_noise = "1 %"', "[test.sees]"]
        text += [f"points = {json.dumps(points)}", "direction = [0, 0, 1]"]
    path = folder / f"{name.replace(' ', '_')}.toml"
    path.write_text("\n".join(text) + "\n", encoding="ascii")
    return path


def ours(folder: Path, *command: str) -> dict:
    """The JSON of one of our commands."""
    out = folder / "found.json"
    full = [*launcher(None), "fenics-joints", *command, "--json", str(out)]
    run(full, Path.cwd(), threads(1))
    return json.loads(out.read_text(encoding="utf-8"))


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--folder", type=Path, help="keeps all files there")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = (given.folder or Path(scratch)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        found = compared(folder)
    write(given.json, found)


def compared(folder: Path) -> dict:
    found: dict = {"modes": {}, "diagnoses": {}}
    stored = STEP.format(", SOLVER=MATRIXSTORAGE", 10, "")
    for kind in ("solids", "shells"):
        for part, one in zip("ab", plates(shell=kind == "shells"), strict=True):
            calculix(folder, f"{kind}_{part}", deck([one], stored, kind == "shells"))
    theirs = measured(folder, "as in the case", (1e13, 1e13))
    for kind in ("solids", "shells"):
        modes = ours(folder, "modes", str(case(folder, kind, kind, None)))
        hz = [f for f in modes["frequencies_hz"] if f > 1]
        worst = max(abs(a / b - 1) for a, b in zip(hz, theirs, strict=False))
        found["modes"][kind] = worst
        print(f"{kind}: frequencies within {100 * worst:.3f} % of CalculiX's own")
    for test, halves in TESTS.items():
        measured(folder, test, halves)
        for kind in ("solids", "shells"):
            answer = ours(folder, "diagnose", str(case(folder, f"{test} {kind}", kind, test)))
            leading = answer["effects"][0]
            best = answer["hypotheses"][0]
            values = {
                row["name"]: [row[key] for key in ("value", "low", "high")]
                for row in best["parameters"]
                if not row["nuisance"] and row["identified"]
            }
            found["diagnoses"][f"{test}, {kind}"] = {
                "verdict": answer["verdict"],
                "leading": best["label"],
                "probability": leading["probability"],
                "values": values,
            }
            shown = ", ".join(
                f"{k} {v:.3g} ({a:.3g} to {b:.3g})" for k, (v, a, b) in values.items()
            )
            print(f"{test}, {kind}: {answer['verdict']}: {best['label']}; {shown}")
    return found


if __name__ == "__main__":
    main()
