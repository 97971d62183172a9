"""A page for the database: torque, bolt and plates in, radius and pressure with uncertainty out.

Built with trame and served from this machine only, with nothing fetched from the internet.
"""

from __future__ import annotations

import socket
import sys

from fenics_joints.database.query import Answer, Surfaces, TorqueToForce, query
from fenics_joints.database.tables import in_words
from fenics_joints.errors import InputError
from fenics_joints.formatting import quantity

__all__ = ["serve"]

_HOST = "127.0.0.1"
#: Ways from torque to force: value and what the page calls it.
_WAYS = (
    {"value": "K", "title": "T = K d F (nut factor)"},
    {"value": "motosh", "title": "Motosh (friction in thread and head)"},
    {"value": "force", "title": "the force is known"},
)
_NUMBERS = {
    "torque": "torque", "thickness": "thickness", "K": "nut factor", "friction": "friction",
    "force": "bolt force",
}  # fmt: skip


def serve(surfaces: Surfaces, *, port: int = 8088, browser: bool = True) -> None:
    """Serve the page until Ctrl-C.

    Args:
        surfaces: Fitted.
        port: 0 for any that is free.
        browser: Open the page in the browser.

    Raises:
        InputError: If trame is not installed, or the port is taken.
    """
    try:
        from trame.app import get_server
    except ImportError as error:
        raise InputError(
            "the page needs trame and trame-vuetify: pip install 'fenics-joints[web]'"
        ) from error
    port = _free_port(port)
    server = get_server("fenics-joints database", client_type="vue3")
    _Page(server, surfaces)
    print(f"http://{_HOST}:{port}/ (Ctrl-C ends it)", flush=True)
    # trame reads the command line itself, where its options have other meanings.
    arguments, sys.argv = sys.argv, sys.argv[:1]
    try:
        server.start(
            port=port, host=_HOST, open_browser=browser, show_connection_info=False,
            disable_logging=True, timeout=0,
        )  # fmt: skip
    finally:
        sys.argv = arguments


def _free_port(port: int) -> int:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError as error:
            raise InputError(
                f"--port {port}: {error.strerror}; expected one that is free, or 0 for any"
            ) from error
        return probe.getsockname()[1]


class _Page:
    """State and layout: what is typed, the answer in words, and the picture."""

    def __init__(self, server, surfaces: Surfaces):
        from fenics_joints.database.web_pictures import Pictures

        self._surfaces, self._pictures = surfaces, Pictures(surfaces)
        self._state = server.state
        first = surfaces.rows[0]
        self._state.update({
            "trame__title": "fenics-joints database", "torque": "120", "thickness": "25",
            "bolt": first.bolt or "M12", "way": "K", "K": "0.2", "friction": "0.12",
            "force": "50", "extrapolate": False, "output": next(iter(surfaces.kriging)),
        })  # fmt: skip
        self._answered(self._question())
        self._state.change(
            "bolt", "way", "extrapolate", "output", *_NUMBERS
        )(lambda **_: self._answered(self._question()))  # fmt: skip
        _layout(server, tuple(surfaces.kriging), _about(surfaces))

    def _question(self) -> dict | str:
        """Arguments of `query`, or what is wrong with what was typed."""
        s, values = self._state, {}
        wanted = ["thickness"] + {"K": ["torque", "K"], "motosh": ["torque", "friction"]}.get(
            s.way, ["force"]
        )
        for name in wanted:
            try:
                values[name] = float(str(getattr(s, name)).replace(",", "."))
            except ValueError:
                return f"{_NUMBERS[name]}: expected a number"
        friction = values["friction"] if s.way == "motosh" else None
        return {
            "bolt": s.bolt, "thickness": values["thickness"] * 1e-3,
            "torque": values.get("torque"),
            "force": values["force"] * 1e3 if s.way == "force" else None,
            "torque_to_force": TorqueToForce(values.get("K", 0.2), friction),
            "extrapolate": bool(s.extrapolate),
        }  # fmt: skip

    def _answered(self, question: dict | str) -> None:
        answer, error = None, ""
        try:
            if isinstance(question, str):
                raise InputError(question)
            answer = query(self._surfaces, **question)
        except InputError as problem:
            error = str(problem)
        self._state.error = error
        self._state.update(_said(answer))
        self._state.picture = self._pictures.svg(self._state.output, answer)


def _said(answer: Answer | None) -> dict[str, object]:
    """An answer in the page's words; dashes when there is none."""
    names = ("force_value", "force_words", "radius_value", "radius_words", "pressure_value",
             "pressure_words", "interface_value", "interface_words")  # fmt: skip
    if answer is None:
        return dict.fromkeys(names, "–") | {"extrapolated": False, "notes": []}
    row = answer.identified
    found = "–" if row is None else (
        f"E {quantity(row.E, 'Pa')}, ν {quantity(row.nu)}, h {quantity(row.h, 'm')}"
    )  # fmt: skip
    radius, pressure = in_words(answer.radius, "m"), in_words(answer.pressure, "Pa")
    values = (
        quantity(answer.force, "N"), answer.force_from, *_split(radius), *_split(pressure), found,
        answer.identified_note,
    )  # fmt: skip
    return dict(zip(names, values, strict=True)) | {
        "extrapolated": answer.extrapolated, "notes": list(answer.notes),
    }  # fmt: skip


def _split(words: str) -> tuple[str, str]:
    """``51.4 ± 0.4 mm (95 %: ...)`` in front of and inside the brackets."""
    value, _, rest = words.partition(" (")
    return value, rest.rstrip(")")


def _about(surfaces: Surfaces) -> str:
    sources = dict.fromkeys(j.source for j in surfaces.rows if j.source)
    return f"{len(surfaces.rows)} rows: {surfaces.model or 'no model named'}. " + "; ".join(sources)


# -- layout ----------------------------------------------------------------------------------------


def _layout(server, outputs: tuple[str, ...], about: str) -> None:
    from trame.ui.vuetify3 import VAppLayout
    from trame.widgets import html
    from trame.widgets import vuetify3 as v3

    with VAppLayout(server), v3.VMain(classes="bg-grey-lighten-4"):
        with v3.VContainer(fluid=True, style="max-width: 1280px", classes="pa-6"):
            html.H1("Bolted joint: contact and interface", classes="text-h5 mb-1")
            html.Div(about, classes="text-body-2 text-medium-emphasis mb-5")
            with v3.VRow():
                with v3.VCol(cols=12, md=4):
                    _inputs(v3)
                with v3.VCol(cols=12, md=8):
                    _answer(v3, html)
            _picture(v3, html, outputs)


def _inputs(v3) -> None:
    from fenics_joints.preload.threads import thread_names

    field = {"variant": "outlined", "density": "compact", "hide_details": True, "classes": "mb-4"}
    with v3.VCard(classes="pa-5 fill-height", variant="flat", border=True):
        v3.VAutocomplete(
            v_model=("bolt",), items=("bolts", list(thread_names())), label="Bolt", **field
        )
        _number(v3, "torque", "Tightening torque", "N·m", field, v_if="way !== 'force'")
        _number(v3, "force", "Bolt force", "kN", field, v_if="way === 'force'")
        _number(v3, "thickness", "Thickness of a plate", "mm", field)
        v3.VSelect(
            v_model=("way",), items=("ways", list(_WAYS)), label="Torque to force by", **field
        )
        _number(v3, "K", "Nut factor K", "", field, v_if="way === 'K'")
        _number(v3, "friction", "Friction", "", field, v_if="way === 'motosh'")
        v3.VSwitch(
            v_model=("extrapolate",), label="answer outside the data too", color="orange-darken-2",
            density="compact", hide_details=True, id="input-extrapolate",
        )  # fmt: skip


def _number(v3, name: str, label: str, unit: str, field: dict, **more) -> None:
    v3.VTextField(
        v_model=(name,), label=label, suffix=unit, id=f"input-{name}", inputmode="decimal",
        **field, **more,
    )  # fmt: skip


def _answer(v3, html) -> None:
    with v3.VCard(classes="pa-5 fill-height", variant="flat", border=True):
        v3.VAlert(
            "{{ error }}", v_if="error", type="error", variant="tonal", classes="mb-4", id="error"
        )
        v3.VAlert(
            "Extrapolated: outside the data, where the uncertainty itself is uncertain.",
            v_if="extrapolated", type="warning", variant="tonal", classes="mb-4",
            id="extrapolated",
        )  # fmt: skip
        with v3.VRow():
            for name, title in (("radius", "Contact radius"), ("pressure", "Mean pressure")):
                with v3.VCol(cols=12, sm=6):
                    _figure(html, name, title, "text-h5")
        v3.VDivider(classes="my-4")
        with v3.VRow():
            for name, title in (("force", "Bolt force"), ("interface", "Interface material")):
                with v3.VCol(cols=12, sm=6):
                    _figure(html, name, title, "text-h6")
        html.Div(
            "{{ note }}", v_for="note in notes", key="note",
            classes="text-caption text-medium-emphasis mt-2",
        )  # fmt: skip


def _figure(html, name: str, title: str, size: str) -> None:
    html.Div(title, classes="text-overline text-medium-emphasis")
    html.Div(f"{{{{ {name}_value }}}}", classes=size, id=f"{name}-value")
    html.Div(f"{{{{ {name}_words }}}}", classes="text-body-2", id=f"{name}-words")


def _picture(v3, html, outputs: tuple[str, ...]) -> None:
    with v3.VCard(classes="pa-5 mt-6", variant="flat", border=True):
        with v3.VBtnToggle(
            v_model=("output",), mandatory=True, density="compact", color="primary", divided=True,
            variant="outlined",
        ):  # fmt: skip
            for output in outputs:
                v3.VBtn(f"Contact {output}" if output == "radius" else "Mean pressure",
                        value=output, size="small")  # fmt: skip
        html.Div(v_html=("picture",), classes="mt-3", id="picture")
