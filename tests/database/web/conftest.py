"""The page as the command serves it, to a browser and to a raw client."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest


@pytest.fixture(scope="session")
def page_url():
    """Address of the page; at the end it stops on Ctrl-C, and has said nothing."""
    command = [sys.executable, "-m", "fenics_joints", "database", "web", "--port", "0"]
    server = subprocess.Popen(
        [*command, "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        url = server.stdout.readline().partition(" ")[0]
        assert url.startswith("http://127.0.0.1:"), server.communicate(timeout=30)
        yield url
    finally:
        server.send_signal(signal.SIGINT)
        try:
            _, errors = server.communicate(timeout=20)
        finally:
            server.kill()
    assert (server.returncode, errors) == (0, ""), errors
