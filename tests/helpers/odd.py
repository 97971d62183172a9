"""Odd input for anything that takes input, which is refused with a clear message or accepted."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

from hypothesis import strategies as st

from fenics_joints.errors import JointsError

#: Number of calls, by area and outcome.
COUNTS: Counter[tuple[str, str]] = Counter()

odd_number = st.one_of(
    st.sampled_from(
        [0, -1, 1, 1e300, -1e300, 1e-300, math.nan, math.inf, -math.inf, 2.5, True, 10**30, -0.0, 3]
    ),
    st.floats(),
    st.integers(),
)
odd_text = st.one_of(
    st.sampled_from(
        [
            "",
            " ",
            "nan",
            "inf",
            "1e999",
            "8 mm",
            "69 GPa",
            "1,234",
            "0x10",
            "-5 N",
            "%",
            "\x1b[31m",
            "9**9**9",
            "a" * 300,
            "../..",
            "null",
            "1 m**9**9",
            "٣ mm",
        ]
    ),
    st.text(max_size=40),
)
odd_value = st.one_of(
    st.none(),
    odd_number,
    odd_text,
    st.lists(odd_number, max_size=4),
    st.just({}),
    st.just(object),
    st.lists(st.lists(st.floats(), min_size=3, max_size=3), max_size=3),
    st.just(1j),
    st.binary(),
)
#: Texts that stand in a TOML file in the place of a value.
odd_toml = st.one_of(
    st.sampled_from(
        [
            "-1",
            "0",
            "nan",
            "inf",
            "1e300",
            "true",
            '""',
            '"x"',
            "[]",
            "{}",
            "[[1]]",
            '"-3 mm"',
            '"1e300 m"',
            '"8"',
            '"8 kg"',
            "1979-05-27",
            '"\\u0000"',
            "0.5",
            "2",
            '["a", "a"]',
            '"1 m**9**9"',
            "[1e300, 0, 0]",
            "[nan, 1, 0]",
        ]
    ),
    st.floats().map(lambda x: repr(x)),
    st.integers(-100, 10**20).map(str),
    st.text("abc .[]{}\"'\\=\n#1e", max_size=12),
)


def tried(area: str, act: Callable[[], object]) -> object:
    """The result of a call, or None if it was refused with a clear message; else raises."""
    COUNTS[area, "tried"] += 1
    try:
        result = act()
    except JointsError as error:
        text = str(error)
        assert len(text) > 10 and max(map(len, text.splitlines())) < 1500, text[:2000]
        assert not any(ord(c) < 32 and c not in "\n\t" for c in text), repr(text)
        assert "object at 0x" not in text and "Traceback" not in text, text
        COUNTS[area, "refused"] += 1
        return None
    COUNTS[area, "accepted"] += 1
    return result


@st.composite
def mutated(draw, lines: tuple[str, ...]):
    """A file's lines with up to three faults: odd values; lines gone, twice, swapped or cut."""
    lines = list(lines)
    for _ in range(draw(st.integers(1, 3))):
        i = draw(st.integers(0, len(lines) - 1))
        kind = draw(st.sampled_from(["value", "value", "gone", "twice", "swapped", "text", "cut"]))
        key, equals, _ = lines[i].partition("=")
        if kind == "value" and equals:
            lines[i] = f"{key}= {draw(odd_toml)}"
        elif kind == "gone" and len(lines) > 1:
            del lines[i]
        elif kind == "twice":
            lines.insert(i, lines[i])
        elif kind == "swapped":
            j = draw(st.integers(0, len(lines) - 1))
            lines[i], lines[j] = lines[j], lines[i]
        elif kind == "text":
            at = draw(st.integers(0, len(lines[i])))
            lines[i] = lines[i][:at] + draw(odd_text) + lines[i][at:]
        elif kind == "cut":
            lines[i] = lines[i][: draw(st.integers(0, len(lines[i])))]
    return "\n".join(lines)
