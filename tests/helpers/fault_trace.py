"""A plugin of pytest that notes which tests run which faulty lines, and how long each test takes.

`tests/mutations.py` puts it into a copy of the tree as ``fault_trace.py``, and beside it
``fault_lines.json``: by file [first line, last line, number of the fault]. It writes
``fault_trace.json``: tests by fault, seconds by test that passed.
"""

import json
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
_TOOL, _LINE = sys.monitoring.COVERAGE_ID, sys.monitoring.events.LINE
_START = sys.monitoring.events.PY_START
_LINES = {
    str((ROOT / name).resolve()): [(range(first, last + 1), i) for first, last, i in spans]
    for name, spans in json.loads((ROOT / "fault_lines.json").read_text()).items()
}
_ran: dict[int, set[str]] = {}
_seconds: dict[str, float] = {}
_now = ""


def _started(code, offset):
    spans = _LINES.get(os.path.realpath(code.co_filename))
    if spans and any(line in span for *_, line in code.co_lines() for span, _ in spans):
        sys.monitoring.set_local_events(_TOOL, code, _LINE)
    return sys.monitoring.DISABLE


def _at_line(code, line):
    here = [i for span, i in _LINES[os.path.realpath(code.co_filename)] if line in span]
    for i in here:
        _ran.setdefault(i, set()).add(_now)
    return None if here else sys.monitoring.DISABLE


def pytest_configure():
    sys.monitoring.use_tool_id(_TOOL, "faults")
    sys.monitoring.register_callback(_TOOL, _START, _started)
    sys.monitoring.register_callback(_TOOL, _LINE, _at_line)
    sys.monitoring.set_events(_TOOL, _START)


def pytest_runtest_logstart(nodeid):
    # What a module or a fixture of several tests runs counts for the first test that wants it.
    global _now
    _now = nodeid


def pytest_runtest_logreport(report):
    if report.when == "call" and report.passed:
        _seconds[report.nodeid] = report.duration


def pytest_sessionfinish():
    found = {"ran": {i: sorted(tests) for i, tests in _ran.items()}, "seconds": _seconds}
    (ROOT / "fault_trace.json").write_text(json.dumps(found))
