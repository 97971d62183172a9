"""The C source of a joint law: its UFL and its derivatives, and what runs them.

FFCx compiles expressions on cells of a mesh; a law at the points of a reduced model has no mesh.
Only what laws are written with is known here: arithmetic, functions of one number, conditionals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files

import basix.ufl
import ufl
from ufl.algorithms import expand_indices, strip_variables
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import Condition, Conj, Constant, Indexed, Real, ScalarValue, Variable, Zero
from ufl.corealg.traversal import unique_pre_traversal

from fenics_joints.errors import InputError
from fenics_joints.joint_laws.law import JointLaw, is_rated

#: C of UFL's operators, by the name of their class.
_OPERATORS = {
    "Sum": "{0} + {1}",
    "Product": "{0} * {1}",
    "Division": "{0} / {1}",
    "Power": "pow({0}, {1})",
    "Abs": "fabs({0})",
    "Sign": "({0} > 0.0) - ({0} < 0.0)",
    "Atan2": "atan2({0}, {1})",
    # Not fmin and fmax, which are calls because of what they do with nan.
    "MinValue": "{0} < {1} ? {0} : {1}",
    "MaxValue": "{0} > {1} ? {0} : {1}",
    "Conditional": "{0} ? {1} : {2}",
    "NotCondition": "!{0}",
    "AndCondition": "{0} && {1}",
    "OrCondition": "{0} || {1}",
    "LT": "{0} < {1}",
    "GT": "{0} > {1}",
    "LE": "{0} <= {1}",
    "GE": "{0} >= {1}",
    "EQ": "{0} == {1}",
    "NE": "{0} != {1}",
    "Sqrt": "sqrt({0})",
    "Exp": "exp({0})",
    "Ln": "log({0})",
    "Erf": "erf({0})",
    "Cos": "cos({0})",
    "Sin": "sin({0})",
    "Tan": "tan({0})",
    "Cosh": "cosh({0})",
    "Sinh": "sinh({0})",
    "Tanh": "tanh({0})",
    "Acos": "acos({0})",
    "Asin": "asin({0})",
    "Atan": "atan({0})",
}


def scalar(expression) -> object:
    """A scalar expression with derivatives carried out and indices gone."""
    expression = ufl.as_ufl(expression)
    # A variable keeps the first index it is expanded with, so none may be left.
    return expand_indices(strip_variables(apply_derivatives(apply_algebra_lowering(expression))))


def assignments(results: Sequence[tuple[str, object]], names: Mapping) -> str:
    """C statements that assign scalar expressions; what they share is computed once.

    Args:
        results: (C target, expression from `scalar`), in order.
        names: C name of every constant: of a scalar ``c``, or of a vector's array.

    Raises:
        InputError: If an expression holds something else than constants and functions of them.
    """
    writer = _Writer(names)
    lines = [f"{target} = {writer.name(expression)};" for target, expression in results]
    # Results last: a target may be an input of a later expression.
    return "\n  ".join(["", *writer.lines, *lines])


class _Writer:
    def __init__(self, names: Mapping):
        self.names, self.lines, self.known = names, [], {}

    def name(self, expression) -> str:
        """Name or number of an expression's value; writes the statements that it needs."""
        while isinstance(expression, Variable | Real | Conj):
            expression = expression.ufl_operands[0]
        if expression not in self.known:
            self.known[expression] = self._write(expression)
        return self.known[expression]

    def _write(self, e) -> str:
        if isinstance(e, Zero):
            return "0.0"
        if isinstance(e, ScalarValue):
            return f"({float(e)!r})"
        if isinstance(e, Constant):
            return self._constant(e, None)
        if isinstance(e, Indexed):
            vector, index = e.ufl_operands
            while isinstance(vector, Variable):
                vector = vector.ufl_operands[0]
            return self._constant(vector, int(index[0]))
        operator = type(e).__name__
        if operator not in _OPERATORS:
            raise InputError(
                f"a joint law holds {operator}, which a kernel cannot compute; expected "
                "arithmetic, conditionals and functions of scalars."
            )
        text = _OPERATORS[operator].format(*(self.name(o) for o in e.ufl_operands))
        temporary = f"t{len(self.lines)}"
        kind = "int" if isinstance(e, Condition) else "double"
        self.lines.append(f"const {kind} {temporary} = {text};")
        return temporary

    def _constant(self, constant, i) -> str:
        if constant not in self.names:
            raise InputError(
                f"a joint law depends on {constant}: expected only strain, state and parameters."
            )
        name = self.names[constant]
        return name if i is None else f"{name}[{i}]"


#: UFL's operators of two numbers whose difference chooses a branch.
_COMPARISONS = ("LT", "GT", "LE", "GE", "MinValue", "MaxValue")
#: Inlined everywhere: else elements side by side are not vectorised where there are many callers.
_INLINE = "static inline __attribute__((always_inline)) void"
#: Stubs in place of ``events.c`` for laws with memory, and of ``cycles.c`` for laws without.
_NO_EVENTS = """
int law_events(int P, int E, int K, int T, int panels, int order, const double *Z, const double *Zd,
               const double *synthesis, const double *p, const double *nodes,
               const double *weights, double *F, double *J)
{ return 1; }
"""
_NO_CYCLES = """
int law_harmonic(int P, int E, int K, int T, int cycles, int exact, int order,
                 const double *X, const double *Xd, const double *synthesis, const double *rules,
                 const double *p, double *s, double *begun, double *F, double *J)
{ return 1; }
"""


def law_source(law: JointLaw, n_slip: int, normal: bool) -> str:
    """C source of a law's elements and of what runs them."""
    d, m = n_slip + normal, law.state_size(n_slip)
    # A domain is asked for by UFL's constants; nothing depends on it.
    domain = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(2,)))
    inputs = d * (1 + is_rated(law))
    strain = ufl.Constant(domain, shape=(inputs,), count=0)
    state = ufl.Constant(domain, shape=(max(m, 1),), count=1)
    p = {key: ufl.Constant(domain, count=2 + i) for i, key in enumerate(law.parameters)}
    names = {strain: "e", state: "s"} | {c: f"p[{i}]" for i, c in enumerate(p.values())}
    # By components: UFL shares what scalars share, and writes out what vectors do.
    e = [ufl.variable(strain[i]) for i in range(inputs)]
    s = [ufl.variable(state[i]) for i in range(m)]
    slip = ufl.as_vector([e[i] for i in range(int(normal), d)])
    opening = e[0] if normal else ufl.as_ufl(0.0)
    rate = {"rate": ufl.as_vector(_rates(e, d, normal))} if inputs > d else {}
    made = law.element(opening, slip, ufl.as_vector(s) if m else None, p, **rate)
    stress, new = _checked(law, made, n_slip, m)
    stress = ([stress[0]] if normal else []) + [stress[1][i] for i in range(n_slip)]
    values = [(f"f[{i}]", scalar(f)) for i, f in enumerate(stress)]
    values += [(f"sn[{i}]", scalar(new[i])) for i in range(m)]
    slopes = _slopes("fe", stress, e, inputs) + _slopes("fs", stress, s, m)
    slopes += _slopes("ne", new, e, inputs) + _slopes("ns", new, s, m)
    found = _switches([*stress, *new], e)
    changes = [(f"g[{i}]", scalar(g)) for i, g in enumerate(found)]
    changes += _slopes("ge", found, e, inputs)
    free = [str(int(all(_slope(g, x) == 0 for x in s))) for g in found]
    defines = {"D": d, "DI": inputs, "M": m, "M1": max(m, 1), "NP": len(p), "NS": len(found)}
    arguments = "const double *e, const double *s, const double *p, double *f, double *sn"
    return "\n".join(
        [
            "#include <math.h>\n#include <stdlib.h>\n#include <string.h>",
            *(f"#define {key} {value}" for key, value in defines.items()),
            f"{_INLINE} element({arguments})\n{{{assignments(values, names)}\n}}",
            f"{_INLINE} element_d({arguments}, double *fe, double *fs, double *ne, double *ns)",
            f"{{{assignments(values + slopes, names)}\n}}",
            f"{_INLINE} switches("
            "const double *e, const double *s, const double *p, double *g, "
            f"double *ge)\n{{{assignments(changes, names)}\n}}",
            f"static const int FREE[] = {{{', '.join(free) or 0}}}; /* whether of no state */",
            *(_text(name) for name in ("kernel.c", "phases.c", "cycles.c" if m else "events.c")),
            _NO_EVENTS if m else _NO_CYCLES,
        ]
    )


def _rates(e: list, d: int, normal: bool) -> list:
    """Rates of the strain: of the normal one, zero where there is none, and of the slip."""
    return ([] if normal else [ufl.as_ufl(0.0)]) + e[d:]


def _switches(stress, e: list) -> list:
    """What the law compares with zero to choose between its branches, each once.

    Operands of comparisons, of the smaller and the larger of two, of absolute values and signs.
    """
    found = {}
    for function in stress:
        for node in unique_pre_traversal(apply_algebra_lowering(ufl.as_ufl(function))):
            if type(node).__name__ in _COMPARISONS:
                first, second = node.ufl_operands
                g = first - second
            elif type(node).__name__ in ("Abs", "Sign"):
                g = node.ufl_operands[0]
            else:
                continue
            if not g.ufl_free_indices and any(_slope(g, x) != 0 for x in e):
                found[str(g)] = g
    return list(found.values())


def _slope(g, x):
    return scalar(ufl.diff(g, x))


def _checked(law: JointLaw, made, n_slip: int, m: int):
    try:
        sigma, tau, new = made
        shapes = ufl.as_ufl(sigma).ufl_shape, ufl.as_ufl(tau).ufl_shape
        shapes += ((0,) if new is None else ufl.as_ufl(new).ufl_shape,)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{law.label}.element: expected (normal stress, traction, new state), UFL ({error})."
        ) from error
    expected = (), (n_slip,), (m,)
    if shapes != expected:
        raise InputError(
            f"{law.label}.element: normal stress, traction and state have shapes {shapes}: "
            f"expected {expected}."
        )
    return (sigma, tau), [] if new is None else [new[i] for i in range(m)]


def _slopes(target: str, functions, variable, n: int) -> list:
    found = []
    for i, function in enumerate(functions):
        found += [
            (f"{target}[{i * n + j}]", scalar(ufl.diff(ufl.as_ufl(function), variable[j])))
            for j in range(n)
        ]
    return found


def _text(name: str) -> str:
    return files("fenics_joints.joint_laws").joinpath(name).read_text(encoding="utf-8")
