"""A page for the database: torque, bolt and plates in, radius and pressure with uncertainty out.

Served from this machine to this machine, with nothing fetched from the internet.
"""

from __future__ import annotations

import threading
import webbrowser

from fenics_joints.database.query import JointSurfaces
from fenics_joints.database.web.page import Page
from fenics_joints.database.web.server import PageServer

__all__ = ["serve"]


def serve(surfaces: JointSurfaces, *, port: int = 8088, browser: bool = True) -> None:
    """Serve the page until Ctrl-C.

    Args:
        surfaces: Fitted.
        port: 0 for any that is free.
        browser: Open the page in the browser.

    Raises:
        InputError: If the port is taken.
    """
    with PageServer(Page(surfaces).reply, port) as server:
        print(f"{server.url} (Ctrl-C ends it)", flush=True)
        if browser:  # one in the terminal comes back only when it is left
            threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            pass
