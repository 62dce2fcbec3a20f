"""`python -m jaxnh.cost`, which is `jaxnh.cli.commands.cost`."""

from jaxnh.cli.commands.cost import main

if __name__ == "__main__":
    raise SystemExit(main())
