"""The input of CalculiX for a specimen: solids, springs at the joint, masses; a step of modes."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from .build import BONDED, Build, Joint
from .meshing import Mesh
from .morph import moved
from .rigs import Rig

#: Ratio of stiffnesses that stand for one, as each needs a card.
_STEP = 1.06
#: N/m at each of the corners: ropes, far below the first mode, without which nothing is held.
_ROPES = 2e3
_EXPANSION = 1e-5


@dataclass(frozen=True)
class Observed:
    """Nodes whose displacements are printed, numbers from 0, rising."""

    nodes: np.ndarray


# -- the joint -------------------------------------------------------------------------------------


def pressures(rig: Rig, mesh: Mesh, joint: Joint) -> list[np.ndarray]:
    """Of each pair of nodes the pressure of the bolts, relative to the peak under one of them.

    It falls as 1 - (r / R)^2 to nothing at the radius R of the cone, so that the contact's area is
    that of the pads, as far as the faces go.
    """
    return [_pressure(rig, mesh, joint, i, loose=False) for i in range(len(mesh.pairs))]


def _pressure(rig: Rig, mesh: Mesh, joint: Joint, number: int, *, loose: bool) -> np.ndarray:
    """Of one interface: by the bolts that press, or what those would that do not."""
    face, pairs = rig.interfaces[number], mesh.pairs[number]
    bolt = sum(len(before.bolts) for before in rig.interfaces[:number])
    p, radius = np.zeros(len(pairs.first)), rig.pad * joint.radius
    for i, centre in enumerate(face.bolts, bolt):
        where = np.array(centre)
        where[:2] += joint.shift
        away = np.linalg.norm(mesh.x[pairs.first] - where, axis=1)
        if (i in joint.loose) == loose:
            p += np.clip(1 - (away / radius) ** 2, 0, None)
    return p


def stiffness(p: np.ndarray, joint: Joint, face: int, tightening: float):
    """Normal and tangential stiffness, Pa/m, at pressures p (k,) and a torque over the highest."""
    if joint.gasket is not None:
        return np.full(len(p), joint.gasket[0]), np.full(len(p), joint.gasket[1])
    bonded = BONDED * p
    if joint.faces is not None and face not in joint.faces:
        return bonded, bonded
    out = []
    for k in (joint.k_n, joint.k_t):
        with np.errstate(divide="ignore", invalid="ignore"):
            soft = np.inf if k is None else k * (p * tightening) ** joint.beta
            out.append(np.where(p > 0, 1 / (1 / bonded + 1 / soft), 0.0))
    return out[0], out[1]


# -- the deck --------------------------------------------------------------------------------------


def write_deck(
    rig: Rig, mesh: Mesh, build: Build, observed: Observed, n_modes: int, tightening: float = 1.0
) -> str:
    """The text of the input.

    Args:
        rig: The rig.
        mesh: Its mesh.
        build: How the specimen is built.
        observed: What is printed.
        n_modes: How many modes, with those of a rigid body.
        tightening: Torque over the highest.
    """
    x = moved(rig, mesh, build)
    out = ["*NODE, NSET=NALL", *_nodes(x)]
    number = _solids(out, rig, mesh, build, x)
    springs, masses = _joint(rig, mesh, build, tightening), defaultdict(float)
    for node, kg in _heads(rig, mesh, build):
        masses[node] += kg
    _attached(out, rig, mesh, build, x, springs, masses)
    number = _springs(out, springs, number)
    _masses(out, masses, number)
    nodes = [str(i + 1) for i in observed.nodes]
    out += ["*NSET, NSET=SEEN", *(", ".join(nodes[i : i + 10]) for i in range(0, len(nodes), 10))]
    perturbed = _prestress(out, rig, mesh, build, x)
    out += [
        f"*STEP{perturbed}",
        "*FREQUENCY",
        f"{n_modes}",
        "*NODE PRINT, NSET=SEEN",
        "U",
        "*END STEP",
        "",
    ]
    return "\n".join(out)


def _nodes(x) -> list[str]:
    return [f"{i}, {a:.9g}, {b:.9g}, {c:.9g}" for i, (a, b, c) in enumerate(x, 1)]


def _solids(out: list[str], rig: Rig, mesh: Mesh, build: Build, x) -> int:
    """Cells and materials of all bodies; the first number that is free."""
    number = 1
    for i, body in enumerate(rig.bodies):
        cells = mesh.cells[i]
        for part, (chosen, E, rho) in enumerate(_patches(mesh, cells, build)):
            if not len(chosen):
                continue
            name = f"B{i}P{part}"
            out.append(f"*ELEMENT, TYPE=C3D10, ELSET={name}")
            for row in chosen + 1:
                out.append(", ".join(map(str, [number, *row])))
                number += 1
            rho = body.rho * build.rho.get(i, 1.0) * rho
            out += [
                f"*MATERIAL, NAME={name}",
                *_elastic(i, body, build, E),
                "*DENSITY",
                f"{rho:.8e}",
                "*EXPANSION",
                f"{_EXPANSION}",
                f"*SOLID SECTION, ELSET={name}, MATERIAL={name}",
            ]
    return number


def _patches(mesh: Mesh, cells, build: Build):
    """Cells with factors on E and rho: each patch, and the rest."""
    centre = mesh.x[cells[:, :4]].mean(axis=1)
    rest = np.ones(len(cells), dtype=bool)
    for place, radius, E, rho in build.patches:
        near = rest & (np.linalg.norm(centre - np.array(place), axis=1) < radius)
        rest &= ~near
        yield cells[near], E, rho
    yield cells[rest], 1.0, 1.0


def _elastic(number: int, body, build: Build, factor: float) -> list[str]:
    E = body.E * build.E.get(number, 1.0) * factor
    G = body.E / (2 * (1 + body.nu)) * build.E.get(number, 1.0) * factor * build.G.get(number, 1.0)
    rolled = build.rolled.get(number, 1.0)
    if rolled == 1.0 and number not in build.G:
        return ["*ELASTIC", f"{E:.8e}, {body.nu:.8e}"]
    moduli = [E, E, E]
    moduli[body.axis] *= rolled
    nu = body.nu
    first = [*moduli, nu, nu, nu, G, G]
    return [
        "*ELASTIC, TYPE=ENGINEERING CONSTANTS",
        ", ".join(f"{v:.8e}" for v in first),
        f"{G:.8e}",
    ]


def _joint(rig, mesh: Mesh, build: Build, tightening) -> dict:
    """Springs by (component, stiffness) with their pairs of nodes; single nodes: to the ground."""
    springs: dict[tuple[int, float], list] = defaultdict(list)
    joint = build.joint
    for number, p in enumerate(pressures(rig, mesh, joint)):
        pairs, axis = mesh.pairs[number], rig.interfaces[number].axis
        normal, tangential = stiffness(p, joint, number, tightening)
        if joint.loose:
            resting = joint.rest * _pressure(rig, mesh, joint, number, loose=True)
            normal, tangential = normal + resting, tangential + resting
        for component in range(3):
            k = (normal if component == axis else tangential) * pairs.area
            used = np.flatnonzero(k > 1e-9 * k.max())
            level = np.exp(np.round(np.log(k[used]) / np.log(_STEP)) * np.log(_STEP))
            for i, value in zip(used, level, strict=True):
                springs[component, float(value)].append((pairs.first[i], pairs.second[i]))
    return springs


def _springs(out: list[str], springs: dict, number: int) -> int:
    for count, ((component, k), ends) in enumerate(sorted(springs.items())):
        single = not isinstance(ends[0], tuple)
        kind = "SPRING1" if single else "SPRING2"
        out.append(f"*ELEMENT, TYPE={kind}, ELSET=S{count}")
        for end in ends:
            nodes = [end] if single else end
            out.append(", ".join(str(v) for v in (number, *(node + 1 for node in nodes))))
            number += 1
        direction = f"{component % 3 + 1}"
        out += [
            f"*SPRING, ELSET=S{count}",
            direction if single else f"{direction}, {direction}",
            f"{k:.8e}",
        ]
    return number


def _masses(out: list[str], masses: dict, number: int) -> None:
    by_mass = defaultdict(list)
    for node, kg in masses.items():
        by_mass[round(kg, 12)].append(node)
    for count, (kg, nodes) in enumerate(by_mass.items()):
        out.append(f"*ELEMENT, TYPE=MASS, ELSET=M{count}")
        for node in nodes:
            out.append(f"{number}, {node + 1}")
            number += 1
        out += [f"*MASS, ELSET=M{count}", f"{kg:.8e}"]


def _heads(rig: Rig, mesh: Mesh, build: Build):
    """Masses of the bolts, on the nodes of the interface near each on both sides."""
    bolt = 0
    for face, pairs in zip(rig.interfaces, mesh.pairs, strict=True):
        for centre in face.bolts:
            away = np.linalg.norm(mesh.x[pairs.first] - np.array(centre), axis=1)
            near = np.flatnonzero(away < 0.75 * rig.pad)
            share = rig.head_mass * build.heads / (2 * len(near))
            for i in near:
                yield int(pairs.first[i]), share
                yield int(pairs.second[i]), share
            bolt += 1


def nearest(mesh: Mesh, place) -> int:
    """The node of the surface that is nearest to a place of the drawing."""
    surface = np.unique(np.concatenate([f.ravel() for f in mesh.faces]))
    return int(surface[np.argmin(np.linalg.norm(mesh.x[surface] - np.array(place), axis=1))])


def _attached(out, rig, mesh: Mesh, build: Build, x, springs, masses) -> None:
    corners = {nearest(mesh, place) for place in _corners(mesh)}
    for node in sorted(corners):
        for component in range(3):
            springs[component + 3, _ROPES].append(node)
    for place, kg in build.masses:
        masses[nearest(mesh, place)] += kg
    for place, axis, k in build.springs:
        springs[axis + 3, k].append(nearest(mesh, place))
    for body, kg, low, high in build.lining:
        for node, share in _lined(rig, mesh, body, low, high):
            masses[node] += kg * share
    if build.joint.gasket_mass:
        for pairs in mesh.pairs:
            for node, area in zip(pairs.first, pairs.area, strict=True):
                masses[int(node)] += build.joint.gasket_mass * area
    for i, (place, kg, hz) in enumerate(build.tuned):
        node = nearest(mesh, place)
        out += ["*NODE, NSET=NALL", f"{len(x) + i + 1}, " + ", ".join(f"{v:.9g}" for v in x[node])]
        masses[len(x) + i] += kg
        for component in range(3):
            springs[component, kg * (2 * np.pi * hz) ** 2 * (1 + 1e-9 * i)].append(
                (node, len(x) + i)
            )


def _corners(mesh: Mesh):
    """Four places far apart on the structure."""
    way = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    return mesh.x[np.argmax(mesh.x @ way.T, axis=0)]


def _lined(rig, mesh: Mesh, body: int, low: float, high: float):
    """Nodes of a body's outer faces between two shares of its axis, with shares of the area."""
    faces, axis = mesh.faces[body], rig.bodies[body].axis
    a, b, c = (mesh.x[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    middle = (a + b + c)[:, axis] / 3
    own = mesh.x[mesh.body == body][:, axis]
    s = (middle - own.min()) / (own.max() - own.min())
    used = (s >= low) & (s <= high)
    share: dict[int, float] = defaultdict(float)
    for nodes, value in zip(faces[used], area[used] / area[used].sum() / 3, strict=True):
        for node in nodes[3:]:
            share[int(node)] += float(value)
    return share.items()


def _prestress(out, rig, mesh: Mesh, build: Build, x) -> str:
    """A first step with strains of their own, hotter in the middle of a body than at its rim."""
    if not build.warm:
        return ""
    out += [
        "*INITIAL CONDITIONS, TYPE=TEMPERATURE",
        "NALL, 0.",
        "*STEP, NLGEOM",
        "*STATIC",
        "*TEMPERATURE",
    ]
    for body, strain in build.warm.items():
        own = np.flatnonzero(mesh.body == body)
        low, high = mesh.x[own].min(axis=0), mesh.x[own].max(axis=0)
        s = 2 * (mesh.x[own] - low) / (high - low) - 1
        plane = [i for i in range(3) if i != rig.bodies[body].normal]
        field = np.prod(1 - s[:, plane] ** 2, axis=1)
        heat = strain / _EXPANSION * field
        out += [f"{node + 1}, {t:.6g}" for node, t in zip(own, heat, strict=True)]
    out += ["*END STEP"]
    return ", PERTURBATION"
