"""Print a kernel of OpenBLAS that this processor has beside the one that runs; say so if none.

For ``OPENBLAS_CORETYPE``: what solvers give to the last digits depends on it. Each candidate is
tried in a process of its own, for OpenBLAS falls back to another without a word.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

#: Kernels by what they need of the processor, and names of those that compute alike.
KERNELS = {
    "SkylakeX": ({"avx512f", "avx512bw", "avx512vl"}, {"SkylakeX", "Cooperlake", "SapphireRapids"}),
    "Haswell": ({"avx2", "fma"}, {"Haswell", "Zen", "Excavator"}),
    "Nehalem": ({"sse4_2"}, {"Nehalem"}),
}
_ASK = """
import numpy, threadpoolctl
print(*{i["architecture"] for i in threadpoolctl.threadpool_info() if "architecture" in i})
"""


def running(kernel: str | None = None) -> set[str]:
    """Kernels that numpy's BLAS runs when this one is asked for; by default as the machine says."""
    asked = {**os.environ, "OPENBLAS_CORETYPE": kernel} if kernel else dict(os.environ)
    done = subprocess.run([sys.executable, "-c", _ASK], env=asked, capture_output=True, text=True)
    return set(done.stdout.split())


def main() -> None:
    cpu = Path("/proc/cpuinfo")
    flags = set(cpu.read_text().split()) if cpu.exists() else set()
    now = running()
    for kernel, (needs, alike) in KERNELS.items():
        if now and needs <= flags and not now & alike and running(kernel) & alike:
            print(kernel)
            return
    what = ", ".join(sorted(now)) or "no OpenBLAS"
    print(f"no other kernel of BLAS on this {platform.machine()} ({what})", file=sys.stderr)


if __name__ == "__main__":
    main()
