"""Every quantitative claim of README and documentation, beside the figure that it rests on: checked, and one page.

    make claims

The claims are in `claims_table.py`. One fails where its words are not in the text any more, or where what it is read
from does not round to the number quoted. Nothing is timed or computed anew here; each page of results names the code
that it was measured at, and results/claims.md says where that is an older one.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jaxnh
from sweeps.checks.claims_table import CLAIMS, Claim
from sweeps.checks.measured_at import ROOT, age, last_commit, stamps_of

PAGE = "results/claims.md"


class Finding(NamedTuple):
    """A claim, whether it failed, and how it stands in a few words."""

    claim: Claim
    failed: bool
    state: str


def check(claim: Claim, root: Path = ROOT) -> Finding:
    """Check that the words are there, and that the numbers are those of the source."""
    text = (root / claim.where).read_text(encoding="utf-8")
    if _folded(claim.words) not in _folded(text):
        return Finding(claim, True, f"not in {claim.where}: {claim.words!r}")
    if not (root / claim.source).exists():
        state = f"{claim.source} is not there" if claim.kept else "not checked: the file is not kept"
        return Finding(claim, claim.kept, state)
    if claim.read is None:
        return Finding(claim, False, "seen in the picture")
    try:
        values = claim.read(root)
    except (jaxnh.ResultError, LookupError, OSError, ValueError) as error:
        return Finding(claim, True, f"nothing to read in {claim.source}, {claim.place}: {error}")
    if len(values) != len(claim.numbers):
        return Finding(claim, True, f"{len(claim.numbers)} numbers quoted, {len(values)} read: {claim.words!r}")
    wrong = [f"{q} is {v:.{len(q) + 1}g}" for q, v in zip(claim.numbers, values, strict=True) if not rounds_to(v, q)]
    return Finding(claim, bool(wrong), f"{claim.words!r}: {'; '.join(wrong)}" if wrong else "agrees")


def rounds_to(value: float, quoted: str) -> bool:
    """Return whether a value, rounded to the digits of a quoted number, is that number."""
    plain = quoted.replace(",", "").replace("−", "-")
    digits = plain.lower().partition("e")[0].partition(".")[2]
    form = "e" if "e" in plain.lower() else "f"
    return float(f"{value:.{len(digits)}{form}}") == float(plain)


def page(findings: Sequence[Finding], root: Path = ROOT) -> str:
    """The page in Markdown."""
    lines = [
        "# Claims",
        "",
        "Written by `make claims`: every quantitative claim of README and documentation, the command that makes its",
        "figure again, the commit that the figure is of, and what it is read from. A number in bold is checked.",
        "",
        "| claim | in | command | commit | rests on | |",
        "|---|---|---|---|---|---|",
    ]
    for claim, _, state in findings:
        quote = " ".join(claim.quote.replace("[", "**").replace("]", "**").split())
        rests = f"{_link(claim.source)}: {claim.place}"
        cells = (quote, claim.where, f"`{claim.command}`", _commit(claim.source, root), rests, state)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n\n" + _ages(root)


def _link(source: str) -> str:
    """A page of results as a link from beside it, also where docs/results shows both; another file by its name."""
    path = Path(source)
    return f"[{source}]({path.name})" if path.parent.name == "results" and path.suffix == ".md" else f"`{source}`"


def _commit(source: str, root: Path) -> str:
    """The commit that a page of results names; of other files the one that last changed them."""
    path = root / source
    if path.suffix == ".md":
        named = stamps_of(path.read_text(encoding="utf-8")) if path.exists() else []
        return ", ".join(dict.fromkeys(was.commit for was in named)) or "names none"
    changed = last_commit(source, root)
    return f"last changed in {changed}" if changed else "–"


def _ages(root: Path) -> str:
    """Pages of results and how old the code is that they were measured at."""
    others = ("README.md", Path(PAGE).name)
    pages = [f"results/{path.name}" for path in sorted((root / "results").glob("*.md")) if path.name not in others]
    lines = [f"- `{name}`: {age((root / name).read_text(encoding='utf-8'), root)}" for name in pages]
    return "## Pages and the code that they were measured at\n\n" + "\n".join(lines) + "\n"


def _folded(text: str) -> str:
    return " ".join(text.split())


def main() -> None:
    """Check all claims and write the page; exit code 1 where one fails."""
    findings = [check(claim) for claim in CLAIMS]
    for finding in findings:
        if finding.failed:
            print(finding.state, file=sys.stderr)
    text = page(findings)
    (ROOT / PAGE).write_text(text, encoding="utf-8")
    print(text.partition("## Pages")[2].partition("\n\n")[2], end="")
    failed = sum(finding.failed for finding in findings)
    print(f"{len(findings)} claims, {failed} failed; wrote {PAGE}")
    if failed:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
