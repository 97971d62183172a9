"""Functions and nodes of sdynpy's files, laid out as its ``save`` does."""

from __future__ import annotations

import numpy as np
import pytest

from fenics_joints.errors import InputError
from fenics_joints.measurements import read_frfs

WAY = [("node", "u8"), ("direction", "i1")]
F = np.arange(0.0, 51.0)
ENDS = [[(12, 3), (5, 1)], [(13, -2), (5, 1)]]


def functions(values: np.ndarray, packed: bool = False) -> np.ndarray:
    kinds = [("ordinate", values.dtype, (len(F),)), ("comment1", "<U80"), ("coordinate", WAY, (2,))]
    data = np.zeros(2, ([] if packed else [("abscissa", "f8", (len(F),))]) + kinds)
    if not packed:
        data["abscissa"] = F
    data["ordinate"], data["coordinate"] = values, np.array(ENDS, WAY)
    return data


def geometry(path, turned: bool = False) -> None:
    nodes = np.zeros(3, [("id", "u8"), ("coordinate", "f8", (3,)), ("def_cs", "u8")])
    nodes["id"], nodes["coordinate"] = [5, 12, 13], [[0, 0, 0], [0, 0, 100], [0, 200, 0]]
    systems = np.zeros(1, [("id", "u8"), ("cs_type", "u2"), ("matrix", "f8", (4, 3))])
    systems["matrix"], systems["cs_type"] = np.eye(4, 3), int(turned)
    lines = np.array([{"a pickle": 1}], dtype=object)
    np.savez(path, node=nodes, coordinate_system=systems, traceline=lines)


@pytest.mark.parametrize("packed", [False, True])
def test_functions_coherence_and_nodes(tmp_path, packed):
    values = np.exp(1j * np.outer([1.0, 2.0], F))
    start = {"abscissa_start": F[0], "abscissa_step": 1.0} if packed else {}
    np.savez(tmp_path / "h.npz", data=functions(values, packed), function_type=4, **start)
    np.savez(tmp_path / "c.npz", data=functions(np.full((2, len(F)), 0.9)), function_type=6)
    geometry(tmp_path / "g.npz")
    files = [tmp_path / f"{name}.npz" for name in "hcg"]
    found = read_frfs(files, units="m/s2/N", length_unit="mm")
    assert found.frequencies_hz.tolist() == F[1:].tolist()
    by_name = dict(zip(found.response_names, range(2), strict=True))
    at = [found.response_points[i].tolist() for i in range(2)]
    assert sorted(at) == [[0, 0, 0.1], [0, 0.2, 0]]
    assert found.coherence == pytest.approx(0.9)
    # Against an axis a response has the other sign.
    first, second = (next(i for n, i in by_name.items() if n.startswith(s)) for s in ("12", "13"))
    assert found.values[:, first, 0] == pytest.approx(values[0, 1:])
    sign = found.response_directions[second] @ [0, -1, 0]
    assert found.values[:, second, 0] == pytest.approx(sign * values[1, 1:])


def test_what_is_not_read_is_said(tmp_path):
    np.savez(tmp_path / "t.npz", data=functions(np.zeros((2, len(F)))), function_type=1)
    np.savez(tmp_path / "p.npz", data=np.array([{}], dtype=object), function_type=4)
    np.savez(tmp_path / "x.npz", a=1)
    (tmp_path / "z.npz").write_text("nothing")
    geometry(tmp_path / "turned.npz", turned=True)
    for name, words in (
        ("t", "of type 1"),
        ("p", "an .npz of numbers"),
        ("x", "expected FRFs or a geometry"),
        ("z", "an .npz of numbers"),
        ("turned", "local axes"),
    ):
        with pytest.raises(InputError, match=words):
            read_frfs(tmp_path / f"{name}.npz", units="m/s2/N", length_unit="mm")
