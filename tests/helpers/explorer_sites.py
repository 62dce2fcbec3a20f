"""Pages of the explorer for several files in one process, each at a port of its own: `python -m tests.helpers.explorer_sites`.

What the command `jaxnh explore` does for one file is done here for all of them, so that tests of pages share imports.
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

from tornado.ioloop import IOLoop

from jaxnh.cli.arguments import read_config
from jaxnh.explorer.opening import open_file, open_texts
from jaxnh.explorer.serve import make_server
from jaxnh.explorer.worker import Watch, Worker

COLUMNS = 128


def serve(sites):
    """Serve sites until SIGTERM, and print the address of each by its name.

    Args:
        sites: name to a file, results that are laid over it, and the address to listen at.
    """
    workers, pages = [], {}
    for name, (file, over, listening) in sites.items():
        path, worker = Path(file), Worker()
        watch, content = Watch(worker), None if path.suffix == ".h5" else read_config(path, [])
        opened = open_file(path, content, (), [Path(each) for each in over], watch, COLUMNS)

        def run(texts, opened=opened, watch=watch):
            return open_texts(opened, texts, watch, COLUMNS)

        server, pages[name] = make_server(opened, worker.start(), listening, 0, run)
        server.start()
        workers.append(worker)
    print(json.dumps(pages), flush=True)
    loop = IOLoop.current()
    signal.signal(signal.SIGTERM, lambda *_: loop.add_callback_from_signal(loop.stop))
    loop.start()
    for worker in workers:
        worker.stop()


if __name__ == "__main__":
    serve(json.loads(sys.argv[1]))
