"""Reading of numbers from pages and result files: rows of a table, cells, patterns, doublings."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import jaxnh

_NUMBER = re.compile(r"[-+−]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")


def rows(text: str, title: str) -> list[dict[str, str]]:
    """Rows of the first table under a heading that begins so, by column.

    Raises:
        LookupError: there is none.
    """
    part = re.search(rf"^## {re.escape(title)}.*?$(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    lines = [line for line in part[1].splitlines() if line.startswith("|")] if part else []
    if len(lines) < 3:
        raise LookupError(f"no table under {title!r}")
    head, _, *body = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines)
    return [dict(zip(head, line, strict=False)) for line in body]


def number(text: str) -> float:
    """The first number in a text.

    Raises:
        LookupError: there is none.
    """
    found = _NUMBER.search(text)
    if found is None:
        raise LookupError(f"no number in {text!r}")
    return float(found[0].replace(",", "").replace("−", "-"))


def cells(source: str, title: str, columns: Sequence[str], **row: str) -> Callable[[Path], list[float]]:
    """Numbers of some columns of the row whose cells are as named (a blank in a name is an underscore)."""

    def read(root: Path) -> list[float]:
        wanted = {key.replace("_", " "): value for key, value in row.items()}
        for line in rows((root / source).read_text(encoding="utf-8"), title):
            if wanted.items() <= line.items():
                return [number(line[column]) for column in columns]
        raise LookupError(f"no row {wanted} under {title!r}")

    return read


def searched(source: str, pattern: str) -> Callable[[Path], list[float]]:
    """Numbers of the groups of a pattern in a text."""

    def read(root: Path) -> list[float]:
        found = re.search(pattern, (root / source).read_text(encoding="utf-8"))
        if found is None:
            raise LookupError(f"no {pattern!r}")
        return [number(group) for group in found.groups()]

    return read


def doublings(source: str, variable: str, level: int, *parameters: str) -> Callable[[Path], list[float]]:
    """A variable of `doubling` at a level, the first is 1; of sensitivities, those in some parameters."""

    def read(root: Path) -> list[float]:
        with jaxnh.open_result(root / source) as tree:
            values = tree["doubling"].to_dataset()[variable][level - 1]
            return np.ravel(values.sel(parameter=list(parameters)) if parameters else values).tolist()

    return read
