"""C statements for scalar UFL expressions of constants.

FFCx compiles expressions on cells of a mesh; a law at the points of a reduced model has no mesh.
Only what laws are written with is known here: arithmetic, functions of one number, conditionals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import ufl
from ufl.algorithms import expand_indices, strip_variables
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import (
    Abs,
    AndCondition,
    Conditional,
    Conj,
    Constant,
    Division,
    Indexed,
    MaxValue,
    MinValue,
    NotCondition,
    OrCondition,
    Power,
    Product,
    Real,
    ScalarValue,
    Sum,
    Variable,
    Zero,
)

from fenics_joints.errors import InputError

__all__ = ["assignments", "scalar"]

_COMPARISONS = {"LT": "<", "GT": ">", "LE": "<=", "GE": ">=", "EQ": "==", "NE": "!="}
_FUNCTIONS = {
    "Sqrt": "sqrt", "Exp": "exp", "Ln": "log", "Cos": "cos", "Sin": "sin", "Tan": "tan",
    "Cosh": "cosh", "Sinh": "sinh", "Tanh": "tanh", "Acos": "acos", "Asin": "asin",
    "Atan": "atan", "Erf": "erf",
}  # fmt: skip


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
        text = self._operation(e, [self.name(o) for o in e.ufl_operands])
        temporary = f"t{len(self.lines)}"
        kind = "int" if isinstance(e, ufl.classes.Condition) else "double"
        self.lines.append(f"const {kind} {temporary} = {text};")
        return temporary

    def _constant(self, constant, i) -> str:
        if constant not in self.names:
            raise InputError(
                f"a joint law depends on {constant}: expected only strain, state and parameters."
            )
        name = self.names[constant]
        return name if i is None else f"{name}[{i}]"

    @staticmethod
    def _operation(e, o: list[str]) -> str:
        kind = type(e).__name__
        if isinstance(e, Sum):
            return f"{o[0]} + {o[1]}"
        if isinstance(e, Product):
            return f"{o[0]} * {o[1]}"
        if isinstance(e, Division):
            return f"{o[0]} / {o[1]}"
        if isinstance(e, Power):
            return f"pow({o[0]}, {o[1]})"
        if isinstance(e, Conditional):
            return f"{o[0]} ? {o[1]} : {o[2]}"
        if isinstance(e, Abs):
            return f"fabs({o[0]})"
        if isinstance(e, MinValue | MaxValue):
            # Not fmin and fmax, which are calls because of what they do with nan.
            sign = "<" if isinstance(e, MinValue) else ">"
            return f"{o[0]} {sign} {o[1]} ? {o[0]} : {o[1]}"
        if isinstance(e, AndCondition | OrCondition):
            return f"{o[0]} {'&&' if isinstance(e, AndCondition) else '||'} {o[1]}"
        if isinstance(e, NotCondition):
            return f"!{o[0]}"
        if kind in _COMPARISONS:
            return f"{o[0]} {_COMPARISONS[kind]} {o[1]}"
        if kind == "Sign":
            return f"({o[0]} > 0.0) - ({o[0]} < 0.0)"
        if kind == "Atan2":
            return f"atan2({o[0]}, {o[1]})"
        if kind in _FUNCTIONS:
            return f"{_FUNCTIONS[kind]}({o[0]})"
        raise InputError(
            f"a joint law holds {kind}, which a kernel cannot compute; expected arithmetic, "
            "conditionals and functions of scalars."
        )
