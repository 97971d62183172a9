"""Charts as elements of a page."""

from __future__ import annotations

import re

from matplotlib.figure import Figure

from fenics_joints.report.style import style, to_svg


def test_names_are_text_and_powers_of_ten_are_not():
    """Half a formula of mathematics ends nothing; ticks keep their powers."""
    name = r"cost $\frac{1$ & <b onclick=x>"
    with style():
        figure = Figure()
        axes, named = figure.subplots(1, 2)
        named.set_yticks([0.0, 1.0], [name, "b"])
        axes.loglog([1e-3, 1e3], [1.0, 2e5], label=name)
        axes.set(title=name, xlabel=name)
        axes.legend()
    text = to_svg(figure, "x", f'"{name}')
    assert text.count(r"cost $\frac{1$ &amp; &lt;b onclick=x&gt;") >= 4
    assert "mathdefault" not in re.sub("<!--.*?-->", "", text, flags=re.DOTALL)
    assert "<b " not in text and 'aria-label="&quot;cost' in text
