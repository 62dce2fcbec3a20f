"""What is imported while programs run, as it will be needed once they are done.

The first dataset that xarray makes asks whether its data are Dask's, and imports `dask.array` for it wherever that is
installed: half a second or more, at the end of a run, in which nothing else goes on. While XLA computes Python waits.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import threading


@functools.cache
def start() -> threading.Thread | None:
    """Import it in a thread, once a process; None where it is not installed."""
    if not importlib.util.find_spec("dask"):
        return None
    thread = threading.Thread(target=_import, args=("dask.array",), name="imports")
    thread.start()
    return thread


def _import(name: str) -> None:
    try:
        importlib.import_module(name)
    except (ImportError, RuntimeError):
        # A Dask without its arrays, which xarray does without as well; or the process ends meanwhile, as one that was
        # interrupted, and what is imported may register nothing for its end any more.
        return
