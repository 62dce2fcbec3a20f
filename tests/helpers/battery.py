"""The battery of hard cases (tests/hard): sizes, rows of its report, and the page results/hard.md that `make hard` writes.

A test there measures at small sizes in `make test` or, where these take long too, `make slow`, and at full ones with
`--hard`. Each number goes through `Battery.row`, which keeps it and asserts its limit, so that page and test cannot
differ. All cases together take three hours of a core: some are measured anew by `--case` or by name, and the page keeps
those of the others.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import pytest

from sweeps.checks.measured_at import stamp

CASES = (
    "Off the constraint",
    "Speed nearly vanishing",
    "Strong force",
    "Fast and slow forcing",
    "Strong contraction",
    "On the edge of a doubling",
    "Deep in the cascade",
    "A thousand branches",
    "Long chaos",
    "Error bars of exponents",
    "Verdicts of longer runs",
    "Coexisting attractors",
    "A poisoned lane",
    "float32 on request",
    "Random systems",
    "The accuracy contract",
)


HELD, REFUSED, FAILED = "held", "refused", "**failed**"
"""Words of the last column of a row; of a refusal, the reason as well."""


class Battery:
    """The setting of a hard case: whether sizes are full, and where its numbers and picture go.

    Attributes:
        full: full sizes, as `make hard` asks for; else small ones.
    """

    def __init__(self, case, full, folder, keep):
        assert case in CASES
        self.case, self.full, self._folder, self._keep = case, full, folder, keep

    def row(self, shown, measured, limit, what=""):
        """Keep a measured number and assert that it is at most its limit. `what` says what the number is."""
        self._keep(
            "hard row",
            [self.case, shown, f"{what} {_number(measured)}".strip(), f"≤ {_number(limit)}", _verdict(measured, limit)],
        )
        assert measured <= limit, f"{shown}: {what} {measured} is above {limit}"

    def refused(self, shown, reason):
        """Keep a case that the engine refuses, with the reason it gives."""
        assert reason
        self._keep("hard row", [self.case, shown, "–", "–", f"{REFUSED}: {reason}"])

    def note(self, text):
        """Keep a sentence for the page, below the table of the case."""
        self._keep("hard note", [self.case, text])

    def picture(self, figure, name, caption):
        """Save a picture beside the page, if one is written."""
        if self._folder is not None:
            figure.savefig(self._folder / f"hard_{name}.png", dpi=90, pil_kwargs={"optimize": True})
            self._keep("hard picture", [self.case, f"![{caption}](hard_{name}.png)"])


def _verdict(measured, limit):
    return HELD if measured <= limit else FAILED


def _number(value):
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.3g}" if value == 0 or 0.01 <= abs(value) < 1e4 else f"{value:.1e}"


@pytest.fixture
def battery(request, record_property):
    """The `Battery` of a test whose module names its CASE, or whose marker `case` does."""
    page = request.config.getoption("--page", default=None)
    marker = request.node.get_closest_marker("case")
    full = request.config.getoption("--hard", default=False)
    record_property("hard case", marker.args[0])
    return Battery(marker.args[0], full, page.parent if page else None, record_property)


def pytest_addoption(parser):
    group = parser.getgroup("hard cases")
    group.addoption("--hard", action="store_true", help="measure the hard cases at full size")
    group.addoption("--case", action="append", choices=CASES, help="this case alone; may be given several times")
    group.addoption("--page", type=Path, default=None, help="write the report of the hard cases to this file")


def pytest_configure(config):
    config.addinivalue_line("markers", "case(name): the hard case that a test belongs to")
    page = config.getoption("--page")
    if page is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Report(page), "hard report")


def pytest_collection_modifyitems(config, items):
    wanted = config.getoption("--case")
    if wanted:
        left = [item for item in items if (case := item.get_closest_marker("case")) and case.args[0] in wanted]
        config.hook.pytest_deselected(items=[item for item in items if item not in left])
        items[:] = left


class BatteryRecord(NamedTuple):
    """A test that has run.

    Attributes:
        node: its name.
        seconds: it took.
        kept: pairs of a name and what was kept under it.
        failed: the last line of why, else empty.
    """

    node: str
    seconds: float
    kept: list[tuple[str, list[str] | str]]
    failed: str

    @property
    def cases(self):
        """The case that it is of, if it came as far as to say so."""
        return [item for name, item in self.kept if name == "hard case"]


class _Report:
    """Collects what tests kept, on whatever worker they ran, and writes the page at the end."""

    def __init__(self, page):
        self._page, self._tests = page, []
        self._stamp = stamp()  # of the code that is imported, not of what is there at the end

    def pytest_runtest_logreport(self, report):
        if report.when != "call" and not report.failed:
            return
        reason = ""
        if report.failed:
            reason = report.longreprtext.strip().splitlines()[-1] if report.longreprtext else "no reason given"
        self._tests.append(BatteryRecord(report.nodeid, report.duration, report.user_properties, reason))

    def pytest_sessionfinish(self, session):
        before = self._page.read_text(encoding="utf-8") if self._page.exists() else ""
        self._page.parent.mkdir(exist_ok=True)
        self._page.write_text(page(self._tests, self._stamp, before), encoding="utf-8")


_HEAD = """\
# Hard cases

Written by `make hard`: the cases that break programs of this kind, each with the number that says stable, the
limit that it has to keep, and the command that measures it alone. `make test` runs them at smaller sizes, some
with fewer scenes (docs/accuracy.md). A scene that is refused, with the reason that the user gets, shows no number and is
no pass. References: Taylor integration in long double (`tests/helpers/taylor.py`), exact identities, and second methods.
`make hard CASE="{case}"` measures one case anew and keeps the others: each test says which code it is of.

"""


def page(tests, measured_at, before=""):
    """The page in Markdown: a section a case, in the order of CASES, in it a table a test; of others those of before."""
    sections = dict(_split(before, "##"))
    for case in CASES:
        of_case = [test for test in tests if case in test.cases]
        if of_case:
            sections[case] = _section(of_case, measured_at, sections.get(case, ""))
    text = "".join(f"\n## {case}\n\n{sections[case].strip()}\n" for case in CASES if case in sections)
    rows = [re.split(r"(?<!\\)\|", line)[-2] for line in text.splitlines() if line.startswith("| ")]
    verdicts = [cell.strip().split(":")[0] for cell in rows]
    held, refused, failed = (verdicts.count(one) for one in (HELD, REFUSED, FAILED))
    unmeasured = [case for case in CASES if case not in sections]
    lost = [f"- {FAILED}: `{test.node}`: {test.failed}\n" for test in tests if test.failed and not test.cases]
    failed_tests = len(lost) + text.count(f"\n- {FAILED}: ")
    total = f"{held} rows held, {refused} refused, {failed} failed; {failed_tests} tests failed.\n"
    missing = f"Not measured: {', '.join(unmeasured)}.\n" if unmeasured else ""
    return _HEAD.format(case=CASES[0]) + total + missing + "".join(lost) + text


def _split(text, level):
    """Headings of a level and what stands below each."""
    return re.findall(rf"^{level} (.+?)\n(.*?)(?=^{level} |\Z)", text, flags=re.MULTILINE | re.DOTALL)


def _section(tests, measured_at, before):
    """Return what the tests of a case have kept, each below its name; of its other tests what the section had before.

    A section of before that has no names of tests stands at the head until all the tests of its commands are anew.
    """
    blocks = dict(_split(before, "###"))
    for function in sorted({_function(test) for test in tests}):
        of_function = sorted((test for test in tests if _function(test) == function), key=lambda test: test.node)
        blocks[function] = _block(of_function, measured_at)
    unnamed = re.split(r"^### ", before, maxsplit=1, flags=re.MULTILINE)[0].strip()
    if set(re.findall(r"^`\S+ --hard \S+::(\w+)`$", unnamed, flags=re.MULTILINE)) <= set(blocks):
        unnamed = ""
    named = [f"### {function}\n\n{block.strip()}" for function, block in blocks.items()]
    return "\n\n".join(part for part in (unnamed, *named) if part)


def _function(test):
    return test.node.split("::")[-1].split("[")[0]


def _block(tests, measured_at):
    """Return what a test has kept, or its cases."""
    kept = [(name, item) for test in tests for name, item in test.kept]
    rows = [item for name, item in kept if name == "hard row"]
    lines = [f"{measured_at} {sum(test.seconds for test in tests):.0f} s.", ""]
    lines += [f"- {FAILED}: `{test.node}`: {test.failed}" for test in tests if test.failed]
    if rows:
        lines += ["", "| what is shown | measured | limit | |", "|---|---|---|---|"]
        lines += [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in item[1:])} |" for item in rows]
    lines += ["", f"`.venv/bin/pytest --hard {tests[0].node.split('[')[0]}`"]
    for name, item in kept:
        if name in ("hard note", "hard picture"):
            lines += ["", item[1]]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines))


def worst(values):
    """Largest of values, as a float; NaN counts as infinite, so that no limit lets it pass."""
    largest = max(float(v) for v in values)
    return largest if math.isfinite(largest) and not any(math.isnan(float(v)) for v in values) else math.inf
