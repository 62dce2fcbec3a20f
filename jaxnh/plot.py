"""`python -m jaxnh.plot`, which is `jaxnh.cli.commands.plot`."""

from jaxnh.cli.commands.plot import main

if __name__ == "__main__":
    raise SystemExit(main())
