"""The C source of a joint law: its UFL and its derivatives, and what runs them."""

from __future__ import annotations

from importlib.resources import files

import basix.ufl
import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.corealg.traversal import unique_pre_traversal

from fenics_joints.errors import InputError
from fenics_joints.joint_laws.c_code import assignments, scalar
from fenics_joints.joint_laws.law import JointLaw, is_rated

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
