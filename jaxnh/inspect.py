"""`python -m jaxnh.inspect`, which is `jaxnh.cli.commands.inspect`."""

from jaxnh.cli.commands.inspect import main

if __name__ == "__main__":
    raise SystemExit(main())
