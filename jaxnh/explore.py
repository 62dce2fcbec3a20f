"""`python -m jaxnh.explore`, which is `jaxnh.cli.commands.explore`."""

import sys

from jaxnh.cli.commands.explore import main

if __name__ == "__main__":
    sys.exit(main())
