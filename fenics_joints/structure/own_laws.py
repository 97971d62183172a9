"""Linear joint laws of your own: a traction or a stress in UFL becomes a `Law` like the suite's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import basix.ufl
import numpy as np
import scipy.linalg
import ufl
from ufl.algebra import Division, Power, Product, Sum
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.expand_indices import expand_indices
from ufl.constantvalue import ComplexValue, ScalarValue, Zero
from ufl.mathfunctions import MathFunction

from fenics_joints.errors import InputError, member, raised, real, wanted
from fenics_joints.files import json_digest
from fenics_joints.forms.kinematics import layer_strain, strain
from fenics_joints.structure.laws import LINEAR_LAWS, SPRINGS, Law
from fenics_joints.units import sizes, to_si

#: Normals at which a law is looked at: any that are along no axis.
_NORMALS = ((0.6, 0.64, 0.48), (2 / 3, -1 / 3, -2 / 3))
#: Decades about the middle of what a unit's quantities may be, over which properties are tried, and
#: the range of ratios: a law must be a sum all over its range.
_DECADES, _RATIOS = 4.0, (0.05, 0.45)
#: Relative error of a law as such a sum.
_SUM = 1e-7
#: Relative difference by which a law may miss linearity and symmetry: round-off.
_ROUND_OFF = 1e-10
#: Numbers of property sets among which a law's samples are sought; the last is more than a
#: symmetric 6 by 6 matrix has entries. And further ones at which the law as a sum is checked.
_TRIED, _FRESH = (4, 8, 24), 8
#: Properties that every law has beside its own.
_TAKEN = ("rho", "meshed", "normal", "cells", "name", "law")


@dataclass(frozen=True)
class _Kind:
    """What a law answers: motions of a unit size, and the work of a response on a motion."""

    motions: tuple
    work: Callable


def _kinds(gdim: int) -> dict[str, _Kind]:
    one = np.eye(gdim)
    pairs = [(one[i], one[j]) for i in range(gdim) for j in range(i)]
    shear = [(np.outer(a, b) + np.outer(b, a)) / 2 for a, b in pairs]
    strains = (*(np.outer(e, e) for e in one), *shear)
    return {"jump": _Kind(tuple(one), ufl.dot), "strain": _Kind(strains, ufl.inner)}


def _range(unit: str) -> tuple[float, float]:
    """Where quantities of a unit are tried."""
    least, most = sizes(unit)
    middle = np.sqrt(least) * np.sqrt(most)
    return middle / 10**_DECADES, middle * 10**_DECADES


def joint_law(of: str = "jump", /, **properties: str | tuple[str, float, float]):
    """Make a linear joint law of a function that gives its traction or stress in UFL.

    The law is then one of the suite's: `interface` takes it, and case files name it. For example,
    an interface that opens when it slides::

        @joint_law(k_n="Pa/m", k_t="Pa/m", k_nt="Pa/m")
        def dilatant(jump, normal, q):
            opening = ufl.dot(jump, normal)
            slip = jump - opening * normal
            first = ufl.as_vector([1, 0, 0])
            across = q["k_nt"] * (ufl.dot(slip, first) * normal + opening * first)
            return q["k_n"] * opening * normal + q["k_t"] * slip + across

    Args:
        of: What the function is given: ``"jump"``, the displacement of the face on the normal's
            side relative to the other one, m, for which it returns the traction, Pa; or
            ``"strain"``, the strain of a layer of cells, for which it returns the stress, Pa.
        properties: Units of its properties by name, such as ``"Pa/m"`` or ``""``; with bounds for
            updating as ``(unit, lower, upper)``.

    Returns:
        A decorator of ``(jump or strain, normal, q) -> UFL``, linear in the first, with ``q`` the
        properties by name. It returns a `fenics_joints.structure.laws.Law`.

    Raises:
        InputError: If a unit is not known, or the function is not linear and symmetric: what the
            joint stores must not depend on the path. A law with memory is a
            `fenics_joints.joint_laws.JointLaw`.
    """
    kind = _kinds(3)[member("of", of, ("jump", "strain"))]
    if not properties:
        raise InputError('joint_law: expected properties with units, such as k_n = "Pa/m".')
    units, bounds = {}, {}
    for key, given in properties.items():
        unit, *limits = given if isinstance(given, tuple) else (given,)
        if key in _TAKEN or not isinstance(unit, str) or len(limits) not in (0, 2):
            raise wanted(f"joint_law: {key}", given, "a unit, or (unit, lower, upper)")
        to_si(1.0, unit)
        units[key] = unit
        if limits:
            low, high = (real(f"{key}, a bound", limit) for limit in limits)
            if not low < high:
                raise wanted(f"joint_law: {key}", given, "(unit, lower, upper) with lower < upper")
            bounds[key] = low, high

    def register(function: Callable) -> Law:
        response = _Response(function, kind, units, bounds)
        law = response.law(of, units, bounds)
        LINEAR_LAWS[law.name] = law
        return law

    return register


class _Response:
    """A user's function, looked at with numbers.

    Args:
        function: The function.
        kind: What it is given.
        units: Units of its properties by name.
        bounds: Bounds of some of them.
    """

    def __init__(self, function: Callable, kind: _Kind, units: Mapping[str, str], bounds):
        self.function, self.kind, self.keys = function, kind, tuple(units)
        self.name = f"{function.__module__}:{function.__qualname__}"
        self._seen: dict[tuple, np.ndarray] = {}  # an evaluation takes milliseconds
        rng, columns = np.random.default_rng(7), []
        for key, unit in units.items():
            low, high = bounds.get(key) or (_RATIOS if not unit else _range(unit))
            at = rng.uniform(0.02, 0.98, _TRIED[-1] + _FRESH)
            inside = low * (high / low) ** at if low > 0 else low + (high - low) * at
            columns.append(inside.tolist())
        sets = [dict(zip(units, row, strict=True)) for row in zip(*columns, strict=True)]
        tried, fresh = sets[:-_FRESH], sets[-_FRESH:]
        self._check(tried[0])
        self.digest = json_digest([self.matrix(q).tolist() for q in tried[:2]])
        self.linear = self._linear(tried)
        if self.linear:
            self.samples = tuple({k: float(k == key) for k in self.keys} for key in self.keys)
        else:
            self.samples = tuple(self._independent(tried))
        self.matrices = np.array([self.matrix(q) for q in self.samples])
        if not self.linear:
            self._pick_entries()
        for q in fresh:
            whole, theta = self.matrix(q), self.scalars(q)
            rest = np.tensordot(theta, self.matrices, axes=1) - whole
            if not np.abs(rest).max() <= _SUM * np.abs(whole).max():
                raise InputError(
                    f"{self.name}: expected a sum of functions of the properties times matrices, "
                    f"at most {_TRIED[-1]} of them"
                )

    def _pick_entries(self) -> None:
        """As many entries of the matrices as there are samples, by which the weights follow, as one
        function of the properties."""
        rank = len(self.samples)
        rows = self.matrices.reshape(rank, -1)
        sizes = np.abs(rows).max(axis=1, keepdims=True)
        chosen = scipy.linalg.qr(rows / sizes, mode="r", pivoting=True)[1][:rank]
        self._inverse = np.linalg.inv((rows / sizes)[:, chosen].T) / sizes
        line = ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,)))
        symbols = {ufl.Constant(line): f"q{i}" for i in range(len(self.keys))}
        given, units = dict(zip(self.keys, symbols, strict=True)), self.kind.motions
        texts = []
        for at in chosen:
            normal, one, other = np.unravel_index(at, self.matrices.shape[1:])
            motion, n = ufl.as_tensor(units[one].tolist()), ufl.as_vector(list(_NORMALS[normal]))
            try:
                answer = self.function(motion, n, given)
            except Exception as error:  # such as math.sqrt, which knows no symbols
                what = f"{self.name}: expected functions of UFL"
                raise InputError(raised(what, error)) from error
            entry = self.kind.work(answer, ufl.as_tensor(units[other].tolist()))
            texts.append(_as_python(expand_indices(apply_algebra_lowering(entry)), symbols))
        arguments = ", ".join(symbols.values())
        self._entries = eval(f"lambda {arguments}: ({', '.join(texts)},)", {"np": np})

    def _work(self, motion: np.ndarray, normal, q: Mapping[str, complex], kind=None) -> list:
        """Work of the response to a motion on each unit motion."""
        given = ufl.as_tensor(motion.tolist()), ufl.as_vector(list(normal))
        q = {key: np.asarray(value).item() for key, value in q.items()}  # UFL knows Python's own
        try:
            answer = self.function(*given, q)
            units = (ufl.as_tensor(unit.tolist()) for unit in (kind or self.kind).motions)
            return [self.kind.work(answer, unit)(()) for unit in units]
        except Exception as error:  # whatever a user's function may raise
            raise InputError(raised(self.name, error)) from error

    def matrix(self, q: Mapping[str, complex]) -> np.ndarray:
        """Work of the response to each unit motion on each other, (n_normals, n, n)."""
        key, units = tuple(q.values()), self.kind.motions
        if key not in self._seen:
            rows = [[self._work(unit, n, q) for unit in units] for n in _NORMALS]
            self._seen[key] = np.array(rows)
        return self._seen[key]

    def _check(self, q: Mapping[str, float]) -> None:
        matrix = self.matrix(q)
        size = np.abs(matrix).max()
        if not np.isfinite(matrix).all() or size == 0:
            raise InputError(f"{self.name}: expected a finite response other than zero.")
        for shares in np.random.default_rng(3).normal(size=(3, len(self.kind.motions))):
            both = self._work(np.tensordot(shares, self.kind.motions, axes=1), _NORMALS[0], q)
            if np.abs(both - shares @ matrix[0]).max() > _ROUND_OFF * size * len(shares):
                raise InputError(
                    f"{self.name}: expected a response that is linear in the motion; a law that is "
                    "not is a fenics_joints.joint_laws.JointLaw."
                )
        if np.abs(matrix - matrix.transpose(0, 2, 1)).max() > _ROUND_OFF * size:
            raise InputError(
                f"{self.name}: expected a symmetric law: the work of the response to one motion on "
                "another must be that of the other on the one."
            )

    def _linear(self, tried) -> bool:
        """Whether it is a sum of its properties times matrices."""
        try:
            units = [self.matrix({k: float(k == key) for k in self.keys}) for key in self.keys]
        except InputError:  # a division by zero
            return False
        for q in tried[: _TRIED[0]]:
            whole = self.matrix(q)
            rest = whole - np.tensordot([q[k] for k in self.keys], units, axes=1)
            if not np.abs(rest).max() <= _ROUND_OFF * np.abs(whole).max():
                return False
        return True

    def _independent(self, tried) -> list[dict]:
        """Property sets whose matrices span those of all."""
        columns = np.zeros((len(_NORMALS) * len(self.kind.motions) ** 2, 0))
        for count in _TRIED:
            new = [self.matrix(q).ravel() for q in tried[columns.shape[1] : count]]
            columns = np.column_stack([columns, *(each / np.abs(each).max() for each in new)])
            _, r, order = scipy.linalg.qr(columns, mode="economic", pivoting=True)
            rank = int(np.sum(np.abs(np.diag(r)) > _ROUND_OFF * abs(r[0, 0])))
            if rank < count:
                break
        return [tried[i] for i in order[:rank]]

    def scalars(self, q: Mapping[str, object]) -> np.ndarray:
        """Weights of the matrices at the samples, (n_samples, ...)."""
        values = np.broadcast_arrays(*(q[key] for key in self.keys))
        if self.linear:
            return np.array(values)
        found = np.broadcast_arrays(*self._entries(*values), values[0])[:-1]
        return np.tensordot(self._inverse, found, axes=1)

    def along(self, of: str, law: Law, normal: tuple[float, ...]) -> Law:
        """The law for a layer of one normal: it refuses properties at which the layer would feed
        energy in."""
        one = np.asarray(normal, dtype=float)
        kind = _kinds(len(one))[of]
        matrices = [[self._work(m, one, q, kind) for m in kind.motions] for q in self.samples]
        return replace(law, check=partial(self.check, np.array(matrices)))

    def at_jump(self, normal: np.ndarray) -> list[np.ndarray]:
        """Traction by the jump at each sample, for a layer of one normal."""
        motions = self.kind.motions
        return [np.array([self._work(m, normal, q) for m in motions]) for q in self.samples]

    def check(self, matrices: np.ndarray, where: str, q: Mapping[str, object]) -> None:
        """Refuse properties at which these matrices' sum is not positive semi-definite."""
        for key in ("rho", "meshed"):
            if key in q and not np.all(np.asarray(q[key]) >= 0):
                raise InputError(f"{where}.{key} = {np.min(q[key]):g}: expected none below zero.")
        matrix = np.tensordot(self.scalars(q).T, matrices, axes=1)
        size = np.abs(matrix).max(axis=(-1, -2))
        good = np.isfinite(size)
        if np.all(good):
            good = np.linalg.eigvalsh(matrix)[..., 0] >= -_ROUND_OFF * size
        if not np.all(good):
            at = int(np.argmin(np.ravel(good)))
            said = ", ".join(
                f"{k} = {np.ravel(np.broadcast_to(q[k], good.shape))[at]:g}" for k in self.keys
            )
            raise InputError(
                f"{where}: {said}: expected values for which the stiffness is positive "
                "semi-definite."
            )

    def law(self, of: str, units: Mapping[str, str], bounds) -> Law:
        """The law, with a density of its own, and for jumps the thickness as meshed, m."""
        more = {"rho": 1.0, "meshed": 1.0} if of == "jump" else {"rho": 1.0}
        return Law(
            self.name,
            (*self.keys, *more),
            self.of_jump if of == "jump" else self.of_strain,
            self.in_layer if of == "jump" else self.scalars,
            tuple(q | more for q in self.samples),
            lambda where, q: None,  # it depends on the normal, see `along`
            inertia=SPRINGS.inertia,
            inertia_term=SPRINGS.inertia_term,
            is_joint=True,
            units=dict(units),
            bounds=dict(bounds),
            digest=self.digest,
            along=partial(self.along, of),
            at_jump=self.at_jump if of == "jump" else None,
        )

    def in_layer(self, q: Mapping[str, object]) -> np.ndarray:
        """`scalars` of a layer as thick as meshed."""
        return self.scalars(q) * q["meshed"]

    def of_jump(self, u, v, q, normal, dx) -> ufl.Form:
        """Stiffness of a layer of cells whose jump is its strain times its thickness."""
        one, other = (_opened(w, normal) for w in (u, v))
        own = {key: q[key] for key in self.keys}
        return ufl.dot(self.function(q["meshed"] * one, normal, own), other) * dx

    def of_strain(self, u, v, q, normal, dx) -> ufl.Form:
        """Stiffness of a layer of cells."""
        one, other = (strain(ufl.grad(w)) for w in (u, v))
        own = {key: q[key] for key in self.keys}
        return ufl.inner(self.function(one, normal, own), other) * dx


def _opened(u, normal):
    """Jump over a layer, per metre of its thickness, as `forms.uncoupled_layer` takes it."""
    opening, slip = layer_strain(ufl.grad(u), normal)
    return opening * normal + slip


#: Operators of UFL in Python, and its functions in NumPy.
_OPERATORS = {Sum: " + ", Product: " * ", Division: " / ", Power: " ** "}
_FUNCTIONS = {"ln": "log", **{n: n for n in "sqrt exp sin cos tan sinh cosh tanh".split()}}


def _as_python(expression, symbols: Mapping[object, str]) -> str:
    """An algebraic expression of symbols as Python's, for numbers and arrays alike.

    Raises:
        InputError: If it has something else.
    """
    if expression in symbols:
        return symbols[expression]
    if isinstance(expression, ScalarValue | Zero):
        return repr(
            complex(expression) if isinstance(expression, ComplexValue) else float(expression)
        )
    inside = [_as_python(each, symbols) for each in expression.ufl_operands]
    for kind, sign in _OPERATORS.items():
        if isinstance(expression, kind):
            return f"({sign.join(inside)})"
    name = getattr(expression, "_name", "") if isinstance(expression, MathFunction) else ""
    if name in _FUNCTIONS:
        return f"np.{_FUNCTIONS[name]}({inside[0]})"
    raise InputError(
        f"joint_law: {type(expression).__name__} of the properties: expected sums, products, "
        "quotients, powers and functions such as sqrt and exp."
    )
