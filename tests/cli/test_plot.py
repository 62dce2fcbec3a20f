"""The command `python -m jaxnh.plot`, and the configs of the paper's figures."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

from jaxnh import plot
from jaxnh.analyses.registry import ANALYSES
from jaxnh.engine.experiment import load
from jaxnh.plotting import results as figures
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.groups import kind_of
from jaxnh.plotting.panels import PANELS
from tests.helpers.hand_made_results import doublings, exponents, states, tree, write

pytestmark = pytest.mark.usefixtures("uncalibrated")
CONFIG = """\
title: A little of everything
system: {constraint: disturbed_speed, d: 0.1}
sweep: {b: {values: [5.8, 2.5, 4.1, 5.3]}}
accuracy: {solver: blanes_moan6, steps: 40}
analyses:
  portrait: {transient: 30, periods: 4, samples: 16}
  poincare: {transient: 30, strobes: 8}
  diagram: {transient: 30, strobes: 16}
  doubling: {levels: 1}
  lyapunov: {transient: 8, periods: 16, exponents: 1}
  period: {transient: 16, max_period: 4}
  chaos01: {transient: 4, periods: 100}
  verdict: {}
  basins: {transient: 32, max_periods: 64}
  branches: {max_period: 1, transient: 30, ds_max: 0.1}
  windows: {max_period: 1, transient: 30, levels: 0, crisis: 0}
  transients: {n_starts: 16, box: {x1: [-0.1, 0.1]}, max_periods: 16}
  manifolds: {n_starts: 2, box: {x1: [-0.1, 0.1]}, length: 0.1, kind: unstable}
  transport: {transient: 1, periods: 256, path: [x1]}
  edges: {n_starts: 4, box: {x1: [-0.1, 0.1]}, transient: 32, pairs: 1, directions: 4, shock_points: 1, reach: 0.1}
"""
OVER_TWO_AXES = {
    "curves": "bifurcation_curves",
    "codimension_two": "special_points",
    "homoclinic": "bifurcation_curves",
    "connecting_orbits": "",
    "atlas": "",
    "curve_orbits": "",
}
"""Groups of analyses that need two, and their panels."""
WITHOUT_CLOCK = ("phase_responses", "surfaces")
"""Panels of what flows without a clock alone have; drawn in `tests/plotting/test_panels.py`."""
B = (5.8, 2.5, 4.1, 5.3)


@pytest.fixture(scope="module")
def everything(tmp_path_factory):
    """A result file with several groups."""
    groups = {
        "portrait": states(B, 4 * 16, "time", "trajectories"),
        "poincare": states(B, 8, panel="points"),
        "diagram": states(B, 16),
        "doubling": doublings((5.52,)),
        "lyapunov": exponents(B, 1),
    }
    return write(tmp_path_factory.mktemp("plot") / "everything.h5", tree(groups))


@pytest.mark.slow  # each alone in tests/analyses/test_batch.py, and made by hand below
@pytest.mark.usefixtures("quick_programs")
def test_every_analysis_says_how_it_is_drawn(result, tmp_path):
    """A run of all that go with one axis: each group names a kind of panel, and is drawn."""
    config = tmp_path / "everything.yaml"
    others = [name for name in ANALYSES if name not in OVER_TWO_AXES and f"\n  {name}: " not in CONFIG]
    config.write_text(CONFIG + "".join(f"  {name}: {json.dumps(dict(ANALYSES[name].brief))}\n" for name in others))
    path, *_ = result("plot_everything", config)
    groups = xr.open_datatree(path, engine="h5netcdf").children
    brought = {name for each in ANALYSES.values() if each.whole for name in each.whole.brings}
    assert set(groups) == (set(ANALYSES) | brought) - set(OVER_TWO_AXES)
    kinds = {kind_of(describe(name, group.to_dataset())) for name, group in groups.items()}
    assert kinds - {""} == set(PANELS) - {*OVER_TWO_AXES.values(), *WITHOUT_CLOCK}
    drawing = figures.figure(path)
    # Portraits, manifolds and tori have a panel for each b, with the points of `poincare` in the first; bifurcations are
    # drawn on their branches, and orbits and curves of tori not at all.
    several = {"portrait", "manifolds", "tori", "poincare", "bifurcations", "orbits", "torus_curves"}
    assert len(drawing.axes) == 3 * 4 + len(groups) - len(several)
    assert len(drawing.get_supxlabel().splitlines()) == 2  # one says of what there is no picture
    for ax in drawing.axes[:4]:
        track, dots = ax.lines
        assert len(track.get_xdata()) == 4 * 16
        assert len(dots.get_xdata()) == 8


@pytest.fixture
def command(monkeypatch, capsys):
    """Exit code, standard output and standard error of the command, run in this process."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["plot", *map(str, arguments)])
        code = plot.main()
        return code, *capsys.readouterr()

    return run


def test_the_command_makes_a_picture(everything, tmp_path):
    picture = tmp_path / "new" / "picture.png"
    arguments = [sys.executable, "-m", "jaxnh.plot", str(everything), "--output", str(picture)]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout == f"wrote {picture}\n"
    pixels = imread(picture)
    assert pixels.shape[1] == 1400
    assert pixels.std() > 0.01
    assert picture.stat().st_size < 1 << 20


def test_every_analysis_of_a_file_has_its_panels(everything):
    """Four portraits with the Poincaré points on them, and a panel each for the rest."""
    drawing = figures.figure(everything)
    assert len(drawing.axes) == 4 + 3
    titles = [ax.get_title() for ax in drawing.axes[:4]]
    assert titles == ["(a) $b$ = 5.8", "(b) $b$ = 2.5", "(c) $b$ = 4.1", "(d) $b$ = 5.3"]
    for ax in drawing.axes[:4]:
        path, points = ax.lines
        assert len(path.get_xdata()) == 4 * 16
        assert len(points.get_xdata()) == 8
    assert drawing.get_suptitle() == "A little of everything"


def test_the_picture_lies_beside_the_file(everything, command, tmp_path):
    file = tmp_path / "copy.h5"
    file.write_bytes(everything.read_bytes())
    assert command(file) == (0, f"wrote {tmp_path / 'copy.png'}\n", "")
    assert (tmp_path / "copy.png").read_bytes().startswith(b"\x89PNG")
    assert command(file, "--output", tmp_path / "copy.svg")[0] == 0


def test_vector_pictures_of_a_column_have_text(command, tmp_path):
    """A PDF of a journal's column, 86 mm; in SVG letters are text, not outlines."""
    pdf, svg = tmp_path / "a.pdf", tmp_path / "a.svg"
    file = write(tmp_path / "a.h5", tree({"diagram": states(B, 16)}))
    assert command(file, "--size", "86x60", "--output", pdf)[0] == 0
    box = re.search(rb"/MediaBox \[ 0 0 ([0-9.]+) ([0-9.]+) \]", pdf.read_bytes())
    assert [float(side) for side in box.groups()] == pytest.approx([86 * 72 / 25.4, 60 * 72 / 25.4], abs=0.01)
    assert command(file, "--size", "column", "--output", svg)[0] == 0
    assert ">A little of everything</text>" in svg.read_text()


def not_hdf5(path):
    path.write_text("title: not a result\n")


def cut_short(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def not_ours(path):
    with h5py.File(path, "w") as file:
        file["x"] = np.arange(3)


def no_analysis(path):
    with h5py.File(path, "r+") as file:
        for name in list(file):
            del file[name]


def without_a_variable(path):
    with h5py.File(path, "r+") as file:
        del file["diagram/x1"]


def without_provenance(path):
    with h5py.File(path, "r+") as file:
        del file.attrs["solver"]


BAD = (not_hdf5, cut_short, not_ours, no_analysis, without_a_variable, without_provenance, Path.unlink)


@pytest.mark.parametrize("spoil", BAD, ids=[spoil.__name__ for spoil in BAD])
def test_a_bad_file_is_said_in_one_line(everything, command, tmp_path, spoil):
    file = tmp_path / "bad.h5"
    file.write_bytes(everything.read_bytes())
    spoil(file)
    code, out, err = command(file)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("command line: FILE: ")
    assert str(file) in err
    assert not (tmp_path / "bad.png").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "FILE"),
        (["{file}", "--colour", "red"], "--colour: nothing is called red to colour by; there are start, b"),
        (["{file}", "--color", "red"], "--color"),
        (["{file}", "--coordinates", "x1,y1,x2"], "--coordinates: it is one name or two, as x,y, not x1,y1,x2"),
        (["{file}", "--coordinates", "x3"], "--coordinates: no diagram of x3 can be drawn; there are x1, x2, y1, y2"),
        (["{file}", "--coordinates", "x1,z"], "--coordinates: no portrait or map of x1, z can be drawn"),
        (["{file}", "--size", "big"], "--size: it is column, page, or millimetres as 120 or 120x80, not big"),
        (["{file}", "--size", "-3"], "--size: it is column"),
        (["{file}", "--size", "40x20"], "--size: the panels do not fit into it"),
        (["{file}", "--label", "up", "--label", "down"], "--label: 1 files need as many labels, and there are 2"),
        (["{file}", "{file}"], "2 results need as many names that differ"),
        (["{file}", "--output", "picture.doc"], "must end in one of .png, .pdf, .svg"),
        (["{file}", "--output", "/proc/none/picture.png"], "--output: cannot write in"),
        (["{folder}"], "is a folder"),
    ],
)
def test_a_bad_command_line_is_said_in_one_line(everything, command, arguments, words):
    arguments = [argument.format(file=everything, folder=everything.parent) for argument in arguments]
    code, out, err = command(*arguments)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert words.lower() in err.lower()


def test_values_that_are_too_many_for_portraits_are_named(tmp_path):
    """Of 20 values of b 12 are drawn, and the picture says so."""
    file = write(tmp_path / "many.h5", tree({"poincare": states(np.arange(20.0), 8, panel="points")}))
    drawing = figures.figure(file)
    assert len(drawing.axes) == 12
    assert drawing.get_supxlabel().endswith("12 of the 20 values of b are drawn")


CONFIGS = Path(__file__).parents[2] / "configs"
PORTRAITS = {1: ("constant_speed", [5.8, 2.5, 4.1, 5.3]), 6: ("disturbed_speed", [5.9, 2.5, 4.2, 5.6])}
WHOLE = {
    **dict.fromkeys((2, 3, 4), ("constant_speed", 0.1, 6.0)),
    **dict.fromkeys((7, 8, 9), ("disturbed_speed", 0.01, 6.0)),
}
ZOOMS = {5: ("constant_speed", 5.487714, 5.519779), 10: ("disturbed_speed", 5.755236, 5.805459)}
ASKED = {
    **dict.fromkeys((1, 6), ("portrait", "poincare")),
    **dict.fromkeys((2, 3, 7, 8), ("lyapunov",)),
    **dict.fromkeys((4, 9), ("diagram",)),
    **dict.fromkeys((5, 10), ("diagram", "doubling")),
}


@pytest.mark.parametrize("number", range(1, 11))
def test_the_configs_say_what_the_paper_says(number):
    """Parameters and start of sections 2 and 3, b of each figure, and zooms that hold the table's first and last."""
    experiment = load(CONFIGS / f"fig{number:02d}.yaml")
    system, (axis,) = experiment.system, experiment.axes
    b = axis.values
    assert axis.name == "b"
    assert tuple(analysis.name for analysis, _ in experiment.requested()) == ASKED[number]
    assert (system.a, system.c, system.omega, getattr(system, "d", None)) == (
        0.5,
        1.0,
        1.0,
        0.1 if number > 5 else None,
    )
    assert (experiment.initial.x1, experiment.initial.x2, experiment.initial.y1) == (0.1, 0.1, 0.1)
    if number in PORTRAITS:
        assert (system.constraint, b.tolist()) == PORTRAITS[number]
    elif number in WHOLE:
        assert (system.constraint, b[0], b[-1]) == WHOLE[number]
    else:
        constraint, last, first = ZOOMS[number]
        assert system.constraint == constraint
        assert b.min() < last < first < b.max()
