"""Claims of the README, each against what it rests on; the check itself; and the line that names the code of a page."""

from __future__ import annotations

import os
import subprocess

import pytest

from sweeps.checks import claims, claims_reading, claims_table, measured_at
from sweeps.checks.claims_table import Claim
from sweeps.checks.measured_at import Stamp
from tests.helpers.paths import ROOT


@pytest.mark.parametrize("claim", claims_table.CLAIMS, ids=lambda claim: claim.words[:40])
def test_claim(claim):
    """The words are in the text, and the numbers are those of the source."""
    finding = claims.check(claim, ROOT)
    assert not finding.failed, finding.state


PAGE = """\
# A page

## Speed, 1 core

Words | not a row.

| over | error | setting |
| --- | --- | --- |
| other | 2.42 ± 0.01× (meets 1.5) | 90 steps, 1,748 kicks |

## Next

| over | error |
| --- | --- |
| other | 7 |
"""


def claim(quote, **row):
    read = claims_reading.cells("page.md", "Speed", ["error"], **(row or {"over": "other"}))
    return Claim("text.md", quote, "make it", "page.md", "Speed", read)


@pytest.fixture
def root(tmp_path):
    (tmp_path / "page.md").write_text(PAGE)
    (tmp_path / "text.md").write_text("It is 2.4 times\nas fast, or 2.5 times.")
    return tmp_path


def test_what_fails(root):
    """Other words, other numbers, another row and a missing picture fail, and say what is wrong; line breaks do not."""
    assert claims.check(claim("is [2.4] times as fast"), root).state == "agrees"
    assert "not in text.md" in claims.check(claim("is [2.4] times slower"), root).state
    assert "2.5 is 2.42" in claims.check(claim("or [2.5] times"), root).state
    assert "2 numbers quoted, 1 read" in claims.check(claim("[2.4] times as fast, or [2.5] times"), root).state
    assert "no row" in claims.check(claim("is [2.4] times", over="none"), root).state
    picture = Claim("text.md", "as fast", "make it", "none.png", "curve")
    assert claims.check(picture, root).failed
    assert all(claims.check(c, root).failed for c in (claim("is [2.4] times slower"), claim("or [2.5] times"), picture))


def test_rounding_to_what_is_quoted():
    assert claims.rounds_to(2.4249, "2.42")
    assert not claims.rounds_to(2.4251, "2.42")
    assert claims.rounds_to(1748.2, "1,748")
    assert claims.rounds_to(-1.016, "−1.02")
    assert claims.rounds_to(1.6e-11, "2e-11")
    assert not claims.rounds_to(2.6e-11, "2e-11")


def test_page_of_claims(root):
    """Numbers that are checked are bold; the code that a page of results names, or that it names none."""
    (root / "results").mkdir()
    (root / "jaxnh").mkdir()
    stamp = Stamp("0123456789ab", measured_at.code_hash(root))
    (root / "results" / "page.md").write_text(f"{PAGE}\n{stamp}\n")
    (root / "results" / "old.md").write_text(PAGE)
    found = [
        claims.check(claim("is [2.4] times")._replace(source=f"results/{name}.md"), root) for name in ("page", "old")
    ]
    text = claims.page(found, root)
    assert "| is **2.4** times | text.md | `make it` | 0123456789ab |" in text
    assert "- `results/page.md`: the code as it is" in text
    assert "- `results/old.md`: names no commit" in text
    (root / "jaxnh" / "new.py").write_text("")
    assert "- `results/page.md`: an older code" in claims.page(found, root)


def test_stamp_of_a_checkout(tmp_path):
    """Commit and hash of the package; changes are said, those of results are not changes; without git, unknown."""
    (tmp_path / "jaxnh").mkdir()
    (tmp_path / "results").mkdir()
    module = tmp_path / "jaxnh" / "a.py"
    module.write_text("a = 1\n")
    assert measured_at.stamp(tmp_path).commit == "unknown"

    def git(*arguments):
        names = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
        subprocess.run(["git", "-C", str(tmp_path), *names, *arguments], check=True, capture_output=True)

    git("init")
    git("add", ".")
    git("commit", "-m", "one")
    clean = measured_at.stamp(tmp_path)
    assert len(clean.commit) == 12
    assert measured_at.stamps_of(f"Words.\n\n{clean}\n\n{clean}\n") == [clean]
    (tmp_path / "results" / "page.md").write_text("new")
    assert measured_at.stamp(tmp_path) == clean
    module.write_text("a = 2\n")
    changed = measured_at.stamp(tmp_path)
    assert changed.commit == f"{clean.commit} with changes"
    assert measured_at.age(str(clean), tmp_path) == "an older code"
    assert measured_at.age(str(changed), tmp_path) == "the code as it is"
    assert measured_at.stamps_of(f"{clean}\n{changed}") == [clean, changed]


def test_files_measured_before_the_last_change(tmp_path):
    (tmp_path / "jaxnh").mkdir()
    module, kept = tmp_path / "jaxnh" / "a.py", tmp_path / "kept.h5"
    for path, when in ((module, 100), (kept, 200)):
        path.write_text("")
        os.utime(path, (when, when))
    assert measured_at.measured_since([kept], tmp_path)
    os.utime(module, (300, 300))
    assert not measured_at.measured_since([kept], tmp_path)
