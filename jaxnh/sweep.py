"""`python -m jaxnh.sweep`, which is `jaxnh.cli.commands.sweep`."""

from jaxnh.cli.commands.sweep import main

if __name__ == "__main__":
    raise SystemExit(main())
