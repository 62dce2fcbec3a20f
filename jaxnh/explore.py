"""`python -m jaxnh.explore`, which is `jaxnh.cli.commands.explore`."""

from jaxnh.cli.commands.explore import main

if __name__ == "__main__":
    raise SystemExit(main())
