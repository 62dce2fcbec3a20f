"""The page in a real Chromium: open, zoom, click, save, reload, keys, editing, two tabs, a server that stops; tokens.

One browser and one process that serves all pages (`helpers.explorer_sites`) are shared; where it is the command itself
that is tested, or what it does to files, it is started (`started`).
"""

from __future__ import annotations

import http.client
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

import jaxnh
from sweeps.timing.explore_tiles import make_chart
from tests.helpers.explorer_sites import COLUMNS
from tests.helpers.hand_made_results import (
    cascade_branches,
    cascade_marks,
    dataset,
    logistic_atlas,
    states,
    tree,
    window_rows,
    write,
)
from tests.helpers.paths import ROOT

pytest.importorskip("panel", reason="the extra explore is missing")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is missing")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")

TILES = 1300  # lanes of each axis: more than the page has pixels
PATIENCE = 120_000  # milliseconds: an end to waiting on machines that do much else, no demand
CONFIG = """
title: The page's own test
system: {constraint: constant_speed, a: 0.5, c: 1.0, omega: 1.0}
sweep: {b: {start: 4.0, stop: 6.0, count: 64}}
accuracy: {solver: blanes_moan6, steps: 60}
analyses:
  diagram: {transient: 48, strobes: 64}
  portrait: {transient: 16, periods: 2, samples: 16}
  poincare: {transient: 16, strobes: 16}
  period: {transient: 64, max_period: 4}
  lyapunov: {transient: 32, periods: 64}
  chaos01: {transient: 32, periods: 128}
  verdict: {confirmation_factor: 0}
"""
CHART = """
title: The page's own chart
system: {file: chart.py}
initial: {x: 0.3}
sweep:
  r: {start: 2.5, stop: 3.4, count: 8}
  k: {start: 0.0, stop: 0.1, count: 8}
analyses:
  period: {transient: 32, max_period: 2}
"""
CHART_MAP = """
def system(r=3.0, k=0.0):
    def image(y):
        (x,) = y
        return (r * x * (1 - x) + k * x,)

    return {"map": image, "coordinates": ("x",)}
"""
SHOTS = os.environ.get("JAXNH_SCREENSHOTS")  # a folder to keep pictures of the page in, for people to look at


def started(*arguments):
    """A server, and the address that it prints."""
    command = [sys.executable, "-m", "jaxnh.explore", *map(str, arguments), "--port", "0"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    assert line.startswith("explore: http://"), line
    return process, line.split()[1]


def ended(process):
    process.send_signal(signal.SIGTERM)
    try:
        return process.wait(20)
    finally:
        process.kill()
        process.stdout.close()


MAP = """\
def system(r=3.2):
    def image(y):
        x, z, w = y
        return r * x * (1 - x), x, z

    return {"map": image, "coordinates": ("x", "z", "w")}
"""
MAP_CONFIG = """\
title: A map
system: {file: own.py}
initial: {x: 0.3}
sweep: {r: {start: 3.0, stop: 3.4, count: 8}}
analyses: {diagram: {transient: 64, strobes: 8}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("explore")


@pytest.fixture(scope="module")
def config(folder):
    path = folder / "page.yaml"
    path.write_text(CONFIG)
    return path


@pytest.fixture(scope="module")
def sites(request, folder, config):
    """Addresses of pages by name; those that compute are slow tests' alone."""
    (folder / "chart.yaml").write_text(CHART)
    (folder / "chart.py").write_text(CHART_MAP)
    (folder / "own.yaml").write_text(MAP_CONFIG)
    (folder / "own.py").write_text(MAP)
    make_chart(folder / "tiles.h5", TILES)
    b = np.linspace(1.0, 6.0, 5)
    results = {
        "cascade": cascade(),
        "spiral": tree({"diagram": states(b, 8), "portrait": states(b, 64, "time", "trajectories")}),
        "plane": plane(),
        "branches": along_the_plane(),
        "atlas": logistic_atlas(),
    }
    for name, result in results.items():
        write(folder / f"{name}.h5", result)
    files = {"config": "page.yaml", "chart": "chart.yaml", "map": "own.yaml", "tiles": "tiles.h5"}
    files |= {name: f"{name}.h5" for name in results}
    files |= {"elsewhere": "cascade.h5"}
    if request.config.getoption("markexpr") == "not slow":
        files = {name: file for name, file in files.items() if file.endswith(".h5")}
    over, listening = {"plane": ["branches.h5"]}, dict.fromkeys(("map", "elsewhere"), "127.0.0.2")
    described = {
        name: (
            str(folder / file),
            [str(folder / each) for each in over.get(name, ())],
            listening.get(name, "127.0.0.1"),
        )
        for name, file in files.items()
        if name != "branches"
    }
    command = [sys.executable, "-m", "tests.helpers.explorer_sites", json.dumps(described)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    yield json.loads(process.stdout.readline())
    assert ended(process) == 0


def cascade():
    """The logistic map's branches over a diagram, of period 1 at x = 1 − 1/b, from b = 3 on unstable."""
    groups = {"branches": cascade_branches(), "bifurcations": cascade_marks(), "windows": window_rows()}
    return tree({"diagram": states(np.linspace(2.5, 3.5, 5), 8), **groups})


def plane():
    """A chart over b and a."""
    axes = {"b": (np.linspace(2.0, 4.0, 9), "coupling b"), "a": (np.linspace(0.0, 1.0, 5), "depth a")}
    about = {"panel": "integers", "panel_variables": "period", "panel_label": "least period"}
    made = {"period": (("b", "a"), np.ones((9, 5), int), "least period", "1")}
    return tree({"period": dataset(axes, made, **about)}, axes="b a")


def along_the_plane():
    """The branches at a = 0.4."""
    config = "system: {file: own.py, a: 0.4}\nsweep: {b: {start: 2, stop: 4, count: 9}}\nanalyses: {branches: {}}\n"
    over = tree({"branches": cascade_branches(), "windows": window_rows()})
    over.attrs |= {"config": config, "system_file": "def system(a=1.0, b=2.0):\n    return {}\n"}
    return over


@pytest.fixture
def address(sites):
    return sites["config"]


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture
def tab(browser):
    """Opens tabs; none of them may ask for anything from elsewhere, or have an error."""
    context = browser.new_context(viewport={"width": 1440, "height": 1050}, accept_downloads=True)
    context.set_default_timeout(PATIENCE)
    wrong = []

    def opened(address):
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda r: None if local(r.url) else wrong.append(r.url))
        page.goto(address)
        return page

    yield opened
    context.close()
    assert not wrong


def local(url):
    return urlsplit(url).hostname in ("127.0.0.1", "127.0.0.2", None) or url.startswith(("data:", "blob:"))


def whole(page, words=f"{COLUMNS} values, 64 strobes after 48 periods"):
    """Wait until the picture is refined."""
    page.get_by_text(words).wait_for()


def view(page, low="low", high="high"):
    query = parse_qs(urlsplit(page.url).query)
    return float(query[low][0]), float(query[high][0])


def shot(page, name):
    if SHOTS:
        page.screenshot(path=f"{SHOTS}/{name}.png")


def zoom(page, *words, left=0.4, right=0.6):
    """Drag a box over a part of the picture, and wait until it says these words, or until a diagram is refined."""
    box = page.locator(".bk-Figure").first.bounding_box()
    top = box["y"] + 0.1 * box["height"]
    page.mouse.move(box["x"] + left * box["width"], top)
    page.mouse.down()
    page.mouse.move(box["x"] + right * box["width"], top + 0.6 * box["height"], steps=4)
    before = page.url
    page.mouse.up()
    page.wait_for_function("before => location.href != before", arg=before)
    whole(page, *words)


@pytest.mark.slow  # `test_live` computes such a view, and a chart of a result goes back and forth in a quick test below
def test_open_zoom_and_go_back(tab, address):
    page = tab(address)
    whole(page)
    shot(page, "opened")
    assert view(page) == (4.0, 6.0)
    zoom(page)
    low, high = view(page)
    assert 4.0 < low < high < 6.0
    assert high - low == pytest.approx(0.4, abs=0.1)  # the axes take a tenth of the figure
    shot(page, "zoomed")
    page.get_by_role("button", name="Whole range").click()
    page.wait_for_function("() => location.search.includes('low=4.0&high=6.0')")
    page.get_by_role("button", name="Back").click()
    page.wait_for_function("() => !location.search.includes('low=4.0&high=6.0')")
    assert view(page) == (low, high)
    page.get_by_role("button", name="Forward").click()
    page.wait_for_function("() => location.search.includes('low=4.0&high=6.0')")


@pytest.mark.slow  # compiles every criterion
def test_a_click_tells_all_of_a_lane(tab, address):
    page = tab(address)
    whole(page)
    box = page.locator(".bk-Figure").first.bounding_box()
    page.mouse.click(box["x"] + 0.93 * box["width"], box["y"] + 0.5 * box["height"])  # b near 5.9: period 1
    page.get_by_text("least period").wait_for()
    page.get_by_text("exponent 3 (95 %)").wait_for()
    page.get_by_text("Kaplan–Yorke dimension").wait_for()
    assert page.locator("table.lane").inner_text().splitlines()[0].startswith("b\t5.")
    shot(page, "clicked")


@pytest.mark.slow
def test_what_is_saved_computes_the_view_again(tab, address, tmp_path):
    page = tab(address)
    whole(page)
    zoom(page)
    low, high = view(page)
    with page.expect_download() as download:
        page.get_by_text("Save as YAML").click()
    saved = tmp_path / "view.yaml"
    download.value.save_as(saved)
    experiment = jaxnh.load(saved)
    [axis] = experiment.axes
    assert (axis.name, axis.values[0], axis.values[-1], len(axis.values)) == ("b", low, high, COLUMNS)
    assert (experiment.accuracy.solver, experiment.accuracy.steps) == ("blanes_moan6", 60)
    with page.expect_download() as download:
        page.get_by_text("Save picture").click()
    download.value.save_as(tmp_path / "view.png")
    assert (tmp_path / "view.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_two_tabs_have_views_of_their_own_that_a_reload_keeps(tab, address):
    one, other = tab(address), tab(address)
    whole(other)
    one.bring_to_front()  # a tab behind another draws nothing
    whole(one)
    zoom(one)
    zoomed = view(one)
    assert zoomed != view(other) == (4.0, 6.0)
    one.reload()
    whole(one)
    assert view(one) == zoomed


@pytest.mark.slow  # of an address that names no view it is said in a quick test
def test_an_error_is_said_on_the_page(tab, address):
    page = tab(address + "&low=4&high=6&p.nothing=1")
    page.get_by_text("there is no parameter nothing").wait_for()
    shot(page, "error")


@pytest.mark.slow
def test_a_result_opens_without_computing_and_a_stopped_server_is_said(tab, config, tmp_path):
    result = tmp_path / "page.h5"
    jaxnh.run(
        jaxnh.load(config, ["sweep.b.count=16", "analyses={diagram: {strobes: 64}, period: {max_period: 2}}"]), result
    )
    process, address = started(result)
    try:
        page = tab(address)
        page.get_by_text("16 values", exact=True).wait_for()
        box = page.locator(".bk-Figure").first.bounding_box()
        page.mouse.click(box["x"] + 0.93 * box["width"], box["y"] + 0.5 * box["height"])
        page.get_by_text("least period").wait_for()
        shot(page, "result")
        assert b"jaxlib" not in maps_of(process)
    finally:
        assert ended(process) == 0
    page.get_by_text("The server has stopped").wait_for()
    shot(page, "stopped")


@pytest.mark.slow  # `test_live_plane` is quick, and a plane is zoomed and clicked at in quick tests below
def test_a_chart_opens_and_is_zoomed_clicked_and_saved(tab, sites, tmp_path):
    page = tab(sites["chart"])
    page.get_by_text("25 × 18 lanes", exact=True).wait_for()
    zoom(page, "25 × 18 lanes")
    (low, high), (bottom, top) = view(page), view(page, "bottom", "top")
    assert 2.5 < low < high < 3.4
    assert 0.0 < bottom < top < 0.1
    box = page.locator(".bk-Figure").first.bounding_box()
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.get_by_text("least period").last.wait_for()
    rows = [line.split("\t") for line in page.locator("table.lane").inner_text().splitlines()]
    assert low <= float(dict(rows)["r"]) <= high
    assert bottom <= float(dict(rows)["k"]) <= top
    shot(page, "chart")
    with page.expect_download() as download:
        page.get_by_text("Save as YAML").click()
    saved = tmp_path / "view.yaml"
    download.value.save_as(saved)
    experiment = jaxnh.load(saved)
    assert [(axis.name, axis.values[0], axis.values[-1]) for axis in experiment.axes] == [
        ("r", low, high),
        ("k", bottom, top),
    ]
    assert [analysis.name for analysis, _ in experiment.requested()] == ["period"]
    with page.expect_download() as download:
        page.get_by_text("Save picture").click()
    download.value.save_as(tmp_path / "view.png")
    assert (tmp_path / "view.png").read_bytes().startswith(b"\x89PNG")
    page.get_by_role("button", name="Back").click()
    page.wait_for_function("() => location.search.includes('bottom=0.0&top=0.1')")


def facts(page):
    """Rows of the table of what was clicked at."""
    return dict(line.split("\t") for line in page.locator("table.lane").first.inner_text().splitlines())


def click(page, across, up):
    """Click at a share of the width and of the height of the frame, from the lower left."""
    box = page.locator(".bk-Figure").first.bounding_box()
    frame = page.evaluate(
        """() => {
          const of = (root) => [...root.querySelectorAll("*")].flatMap((e) => [e, ...(e.shadowRoot ? of(e.shadowRoot) : [])])
          const view = Object.values(Bokeh.index.roots ?? Bokeh.index)[0]
          const find = (v) => v?.model?.name == "view" ? v : [...(v?.child_views ?? [])].map(find).find((x) => x)
          const b = find(view).frame.bbox
          return [b.left, b.top, b.width, b.height]
        }"""
    )
    left, top, width, height = frame
    page.mouse.click(box["x"] + left + across * width, box["y"] + top + (1.0 - up) * height)


def test_curves_are_laid_over_told_by_a_click_and_moved_by_keys(tab, sites):
    page = tab(sites["cascade"] + "&low=2.5&high=3.5&bottom=0&top=1")
    page.get_by_text("5 values", exact=True).wait_for()
    page.wait_for_timeout(500)
    click(page, 0.8, 1 - 1 / 3.3)
    page.get_by_text("period 1, unstable").wait_for()
    assert float(facts(page)["b"]) == pytest.approx(3.3, abs=0.03)
    shot(page, "overlays")
    page.keyboard.press("?")
    page.get_by_role("dialog").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="detached")
    page.keyboard.press("+")
    page.wait_for_function("() => location.search.includes('low=2.75&high=3.25')")
    page.keyboard.press("[")
    page.wait_for_function("() => location.search.includes('low=2.5&high=3.5')")


def test_in_a_narrow_window_nothing_is_wider_than_it_or_lies_over_another_thing(browser, sites):
    """On a telephone the picture comes before the controls, and the legend has fewer columns."""
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    page.goto(sites["cascade"])
    page.get_by_text("5 values", exact=True).wait_for()
    page.wait_for_function("() => Bokeh.documents[0].get_model_by_name('view').above.find((x) => x.ncols == 2)")
    page.wait_for_function("() => document.documentElement.scrollWidth == 390 && innerWidth == 390")
    things = [".status", ".bk-Figure", ".notes", "text=Click into the diagram", "select", "text=Save picture"]
    boxes = [page.locator(name).first.bounding_box() for name in things]
    for above, below in itertools.pairwise(boxes):
        assert above["y"] + above["height"] <= below["y"] + 1
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= 390 for box in boxes)
    assert boxes[1]["width"] > 350
    shot(page, "narrow")
    context.close()


def test_an_atlas_leads_from_a_curve_to_its_orbit_and_says_its_limits(tab, sites):
    """On b + d = 3 the orbit that doubles is at 2/3."""
    page = tab(sites["atlas"] + "&low=2.5&high=3.3&bottom=0.0&top=0.4")
    page.get_by_text("9 × 5 lanes", exact=True).wait_for()
    page.get_by_text("complete to orbits of periods up to 1").wait_for()
    page.wait_for_timeout(500)
    click(page, (2.85 - 2.5) / 0.8, 0.15 / 0.4)
    page.get_by_text("period doubling, period 1").last.wait_for()
    at = facts(page)
    assert float(at["b"].split()[0]) + float(at["d"].split()[0]) == pytest.approx(3.0)
    page.wait_for_function(
        "() => Bokeh.documents[0].get_model_by_name('portrait').renderers[1].data_source.data.x?.length"
    )
    assert page.evaluate(PORTRAIT) == pytest.approx([2 / 3])
    shot(page, "atlas")
    page.locator("select").first.select_option(label="tongues: denominator")
    page.get_by_text("tongues: denominator").last.wait_for()
    page.wait_for_function("() => location.search.includes('variable=tongues')")
    click(page, 0.9, 0.05)
    page.get_by_text("locked to 1/2").wait_for()
    assert facts(page)["attractor 2, periodic, period 1"].startswith("share 0.4")
    shot(page, "atlas_tongues")


PORTRAIT = "() => [...Bokeh.documents[0].get_model_by_name('portrait').renderers[1].data_source.data.x]"
"""Points of the portrait in the plane."""


def steps(page):
    """Ends of the steps of the portrait in space, as the browser has projected them."""
    return page.evaluate("""() => [...Bokeh.documents[0].get_model_by_name("space").renderers[1].data_source.data.x]""")


def turn_in_space(page):
    """A turn of the camera by an angle moves points across by what cos and sin say: their length stays."""
    click(page, 0.5, 0.5)
    page.get_by_role("button", name="space").click()
    page.wait_for_function("() => Bokeh.documents[0].get_model_by_name('space').renderers[1].data_source.data.x?.[0]")
    page.wait_for_timeout(500)
    source = "Bokeh.documents[0].get_model_by_name('space').renderers[1].data_source"
    u, v = (np.array(page.evaluate(f"() => [...{source}.data.{name}]")) for name in "uv")
    angle = np.deg2rad(-60.0)
    assert np.allclose(steps(page), -np.sin(angle) * u + np.cos(angle) * v)
    page.keyboard.press("Shift+ArrowRight")
    angle = np.deg2rad(-55.0)
    assert np.allclose(steps(page), -np.sin(angle) * u + np.cos(angle) * v)
    box = page.locator(".bk-Figure").last.bounding_box()
    before = steps(page)
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 260, box["y"] + 220, steps=4)
    page.mouse.up()
    page.wait_for_timeout(500)
    assert not np.allclose(steps(page), before)
    shot(page, "space")


def test_a_touch_pans_two_fingers_zoom_and_a_portrait_is_turned_in_space(browser, sites):
    """The address names no view: that is said, and the first one is shown."""
    context = browser.new_context(viewport={"width": 1280, "height": 1400}, has_touch=True, is_mobile=True)
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    page.goto(sites["spiral"] + "&low=7&high=5")
    page.get_by_text("a range of b goes from a number up to a larger one").wait_for()
    page.get_by_text("5 values", exact=True).wait_for()
    page.wait_for_timeout(500)
    fingers = context.new_cdp_session(page)
    box = page.locator(".bk-Figure").first.bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]

    def touch(*paths):
        """Fingers along straight lines from one place to another."""
        for kind, share in (("touchStart", 0.0), *(("touchMove", k / 5) for k in range(1, 6)), ("touchEnd", None)):
            at = [] if share is None else [(a + share * (c - a), b + share * (d - b)) for (a, b), (c, d) in paths]
            points = [{"x": across, "y": up, "id": k} for k, (across, up) in enumerate(at)]
            fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch(((x, y), (x - 200, y)))
    page.wait_for_function("() => location.search.includes('low=') && !/low=(1.0|7)&/.test(location.search)")
    low, high = view(page)
    assert low > 1.5
    assert high - low == pytest.approx(5.0)
    touch(((x - 30, y), (x - 150, y)), ((x + 30, y), (x + 150, y)))
    page.wait_for_function(
        "before => location.search != before", arg=urlsplit(page.url).query and "?" + urlsplit(page.url).query
    )
    low, high = view(page)
    assert high - low < 4.0
    turn_in_space(page)
    context.close()


@pytest.mark.slow  # two servers and six pictures; `test_edited_files` and `test_saved_view` are quick
def test_files_are_edited_run_and_saved_and_the_view_is_kept(tab, tmp_path):
    config, system = tmp_path / "own.yaml", tmp_path / "own.py"
    config.write_text(MAP_CONFIG)
    system.write_text(MAP)
    process, address = started(config, "--columns", COLUMNS)
    try:
        page = tab(address)
        whole(page, f"{COLUMNS} values, 8 strobes after 64 periods")
        page.get_by_role("button", name="Edit the files").click()
        areas = page.locator("textarea")
        areas.nth(1).fill(MAP.replace("r * x", "q * x"))
        page.get_by_role("button", name="Check and run").click()
        page.get_by_text("own.py, line 4: NameError: name 'q' is not defined").wait_for()
        assert page.locator(".gutter b").inner_text() == "4"
        shot(page, "editor")
        areas.nth(1).fill(MAP.replace("r * x", "2 * r * x"))
        areas.nth(0).fill(
            MAP_CONFIG.replace("A map", "Another map").replace("start: 3.0, stop: 3.4", "start: 1.5, stop: 1.7")
        )
        page.get_by_role("button", name="Check and run").click()
        page.get_by_text("Another map").first.wait_for()
        whole(page, f"{COLUMNS} values, 8 strobes after 64 periods")
        assert (config.read_text(), system.read_text()) == (MAP_CONFIG, MAP)
        page.get_by_role("button", name="Save to the files").click()
        page.get_by_text("saved: own.yaml, own.py").wait_for()
        assert "2 * r * x" in system.read_text()
        page.get_by_role("button", name="Close the editor").click()
        page.keyboard.press("+")
        page.wait_for_function("() => location.search.includes('low=1.55')")
        whole(page, f"{COLUMNS} values, 8 strobes after 64 periods")
        with page.expect_download() as download:
            page.get_by_text("Save as YAML").click()
        saved = tmp_path / "view.yaml"
        download.value.save_as(saved)
    finally:
        assert ended(process) == 0
    assert [axis.values[0] for axis in jaxnh.load(saved).axes] == [1.55]
    process, address = started(saved, "--columns", COLUMNS)
    try:
        page = tab(address)
        whole(page, f"{COLUMNS} values, 8 strobes after 64 periods")
        assert view(page) == pytest.approx((1.55, 1.65))
        page.keyboard.press("0")
        page.wait_for_function("() => location.search.includes('low=1.5&high=1.7')")
    finally:
        assert ended(process) == 0


@pytest.mark.slow  # it waits for the end of a check's time; `test_edited_files` has the check alone
def test_a_loop_in_an_edited_file_is_said_at_its_line_and_the_server_goes_on(tab, tmp_path):
    (tmp_path / "own.yaml").write_text(MAP_CONFIG)
    (tmp_path / "own.py").write_text(MAP)
    process, address = started(tmp_path / "own.yaml", "--columns", COLUMNS)
    try:
        page = tab(address)
        whole(page, f"{COLUMNS} values, 8 strobes after 64 periods")
        page.get_by_role("button", name="Edit the files").click()
        endless = 'while not __import__("time").sleep(0.1):'  # without work: the other page has the processor
        page.locator("textarea").nth(1).fill(
            MAP.replace("        x, z, w = y", f"        {endless}\n            x, z, w = y")
        )
        page.get_by_role("button", name="Check and run").click()
        page.get_by_text("checking…").wait_for()
        other = tab(address)
        whole(other, f"{COLUMNS} values, 8 strobes after 64 periods")
        other.keyboard.press("+")
        other.wait_for_function("() => location.search.includes('low=3.1')")
        whole(other, f"{COLUMNS} values, 8 strobes after 64 periods")
        page.bring_to_front()
        page.get_by_text("a loop without an end").first.wait_for()
        assert page.locator(".gutter b").inner_text() in ("3", "4")
        shot(page, "loop")
        page.locator("textarea").nth(1).fill(MAP)
        page.get_by_role("button", name="Check and run").click()
        whole(page, f"{COLUMNS} values, 8 strobes after 64 periods")
    finally:
        assert ended(process) == 0


def test_a_large_chart_is_shown_by_blocks_of_lanes_zoomed_down_to_lanes_and_goes_back(tab, sites):
    page = tab(sites["tiles"])
    whole(page, f"{TILES:,} × {TILES:,} lanes, 2 × 2 a pixel")
    shot(page, "tiles")
    zoom(page, re.compile(r"^\d+ × \d+ lanes$"), left=0.3, right=0.5)
    words = page.locator(".status").first.inner_text()
    assert "pixel" not in words
    low, high = view(page)
    assert words.startswith(f"{np.sum(np.abs(np.linspace(0, 1, TILES) - (low + high) / 2) <= (high - low) / 2)} × ")
    click(page, 0.5, 0.5)
    page.get_by_text("least period").last.wait_for()
    assert low <= float(facts(page)["b"]) <= high
    shot(page, "tiles_zoomed")
    zoomed = page.url
    page.get_by_role("button", name="Whole range").click()
    page.wait_for_function("zoomed => location.href != zoomed", arg=zoomed)
    assert view(page) == (0.0, 1.0)
    page.get_by_role("button", name="Back").click()
    page.wait_for_function("zoomed => location.href == zoomed", arg=zoomed)
    page.get_by_role("button", name="Forward").click()
    page.wait_for_function("zoomed => location.href != zoomed", arg=zoomed)


@pytest.mark.slow  # an atlas has them over its plane, and `test_overlays` is quick
def test_windows_and_branches_are_laid_over_a_plane_at_the_other_parameter_of_their_result(tab, sites):
    """The branch of period 1 of the logistic map is stable up to b = 3, and its result is at a = 0.4."""
    page = tab(sites["plane"])
    page.get_by_text("9 × 5 lanes", exact=True).wait_for()
    page.wait_for_timeout(500)
    click(page, (2.8 - 2.0) / 2.0, 0.4)  # the view is from the first lane to the last
    page.get_by_text("period 1, stable").last.wait_for()
    assert float(facts(page)["b"]) == pytest.approx(2.8, abs=0.03)
    assert facts(page)["a"] == "0.4"
    shot(page, "over_plane")


@pytest.mark.slow  # `test_edited_files` asks the page without a browser
def test_files_are_not_edited_from_elsewhere(tab, sites):
    """The sentence stays while the first picture is computed and after it."""
    page = tab(sites["map"])
    page.get_by_role("button", name="Edit the files").click()
    refusal = page.get_by_text("files are edited on the loopback alone")
    refusal.wait_for()
    whole(page, f"{COLUMNS} values, 8 strobes after 64 periods")
    assert refusal.is_visible()


def maps_of(process):
    """Files that a process has mapped, as the libraries that it has loaded."""
    with open(f"/proc/{process.pid}/maps", "rb") as file:
        return file.read()


def test_every_address_needs_the_token(sites):
    """Of the page and of the connection that carries all of it, which a page of another site could ask for."""
    for name in ("atlas", "elsewhere"):  # on the loopback, and elsewhere
        ask_for_the_token(sites[name])


def test_the_command_shows_a_result_and_needs_the_token(folder, sites):
    process, address = started(folder / "cascade.h5", "--over", folder / "branches.h5")
    try:
        ask_for_the_token(address)
        assert b"jaxlib" not in maps_of(process)
    finally:
        assert ended(process) == 0


def ask_for_the_token(address):
    bare, token = address.split("?")
    assert token.startswith("token=")
    for refused in (bare, bare + "?token=wrong"):
        with pytest.raises(urllib.error.HTTPError) as error:
            urllib.request.urlopen(refused)
        assert error.value.code == 403
    assert urllib.request.urlopen(address).status == 200
    assert connected(bare, token) == 101
    assert connected(bare, "token=wrong") in (401, 403)
    assert connected(bare, token, origin="http://elsewhere.example") == 403


def connected(address, query, origin=None):
    """Status of the answer to a connection that is asked for with a session that one has made up oneself."""
    from bokeh.util.token import generate_jwt_token, generate_session_id

    made = generate_jwt_token(generate_session_id(signed=False), signed=False)
    headers = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Protocol": f"bokeh, {made}",
        "Origin": origin or address.rstrip("/"),
    }
    connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=20)
    connection.request("GET", f"/ws?{query}", headers=headers)
    status = connection.getresponse().status
    connection.close()
    return status
