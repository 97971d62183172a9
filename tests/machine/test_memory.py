"""Memory that was freed goes back, or stays for what comes next."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: Arrays between others that stay, as glibc keeps them once a large one was freed.
SCRIPT = """
import numpy as np
from fenics_joints.machine.memory import give_back

def resident():
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024

del_me = np.ones(3_500_000)
del del_me
large, small = [], []
for _ in range(200):
    large.append(np.ones(125_000))
    small.append(np.ones(1000))
large.clear()
before = resident()
give_back()
print(before - resident())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks /proc")
def test_freed_arrays_go_back_to_the_system():
    """Of 200 MB that lie between arrays which stay most."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True)
    assert float(done.stdout) > 100, done.stderr


#: Page faults of arrays that come and go, before and after.
REUSED = """
import resource
import numpy as np
from fenics_joints.machine.memory import hold_freed

def faults():
    first = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        array = np.ones(4_000_000)
        del array
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - first

without = faults()
hold_freed()
faults()
print(without, faults())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of glibc")
def test_freed_arrays_stay_for_the_next():
    done = subprocess.run([sys.executable, "-c", REUSED], capture_output=True, text=True)
    without, held = map(int, done.stdout.split())
    assert held < 0.1 * without, done.stderr
