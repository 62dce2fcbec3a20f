"""Memory of processes."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path


def peak_memory(process: subprocess.Popen) -> int:
    """Largest resident memory of a process in bytes, once it has ended.

    It is looked at while the process runs: `ru_maxrss` of a child is not less than that of its parent was.
    """
    peak, status = 0, Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        lines = status.read_text().splitlines()
        peak = max(peak, *(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:")), 0)
        time.sleep(0.05)
    return peak
