"""What a notebook shows of results: their words, ranges, errors and a picture; of other datasets what xarray shows."""

from __future__ import annotations

import base64
import re
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import jaxnh
from jaxnh.exceptions import ResultError
from jaxnh.plotting.notebook import html
from tests.helpers.hand_made_results import doublings, exponents, states, tree, verdicts

pytestmark = pytest.mark.usefixtures("uncalibrated")
FEW = np.array([5.8, 2.5, 4.1, 5.3])
UP = np.linspace(1.0, 6.0, 30)


def words(text):
    """What a reader sees above xarray's own list."""
    return re.sub(r"<[^>]+>", " ", text.partition("<details>")[0])


def test_a_result_says_what_it_is():
    """Title, axes, accuracy; a row a variable with its ends, largest error and units; and one picture."""
    result = tree({"spectrum": exponents(FEW, 1), "cascade": doublings(), "kinds": verdicts(FEW)})
    text = html(result)
    said = words(text)
    assert "A little of everything" in said
    assert "blanes_moan6, 60 steps a period, error of one period 1e-05" in said
    spectrum = result["spectrum"].to_dataset()
    ends = [f"{value:.6g}" for value in (spectrum["exponents"].min(), spectrum["exponents"].max())]
    assert f"{ends[0]} … {ends[1]}" in said
    assert f"{float(spectrum['exponents_error'].max()):.1g}" in said
    assert text.count("data:image/png;base64,") == 1
    assert "xr-" in text.partition("<details>")[2]


def test_a_group_and_a_dataset_of_it():
    result = tree({"values": states(FEW, 8), "kinds": verdicts(FEW)})
    assert "b (4)" in words(html(result["values"]))
    assert "<img" in html(result["values"].to_dataset())
    kinds = result["kinds"].to_dataset()["kind"]
    assert kinds.attrs["flag_meanings"].split()[int(kinds.min())] in words(html(result["kinds"]))


def test_the_picture_stays_small():
    """Of a result whose panels would fill a column of 12 inches and more the first group is drawn, and this is said."""
    groups = {"values": states(UP, 8), "paths": states(UP[:12], 9, "time", "trajectories")}
    text = html(tree(groups))
    assert "values alone; jaxnh.figure draws all of it" in words(text)
    assert "alone" not in words(html(tree({"values": groups["values"]})))
    picture = base64.b64decode(re.search(r"data:image/png;base64,([^']+)'", text)[1])
    height = int.from_bytes(picture[20:24])  # of the header of a PNG, after its width
    assert height < 12 * 90


def test_others_are_shown_as_before():
    data = xr.Dataset({"a": ("x", [1.0, 2.0])})
    assert words(html(data)) == words(data._repr_html_())
    assert "<img" not in html(data)


def test_text_is_escaped():
    result = tree({"values": states(FEW, 8)})
    result.attrs["title"] = "<script>"
    assert "<script>" not in html(result).partition("<details>")[0]


def test_in_a_notebook_and_only_there():
    """A shell's own formatter shows results so; importing the package imports neither matplotlib nor IPython."""
    code = """
        import sys, jaxnh
        assert not {"matplotlib", "IPython", "xarray"} & sys.modules.keys()
        from IPython.core.interactiveshell import InteractiveShell
        shell = InteractiveShell.instance()
        del sys.modules["jaxnh"]
        import jaxnh
        assert "matplotlib" not in sys.modules
        import xarray as xr
        format = shell.display_formatter.format
        ours = xr.Dataset({"a": ("x", [1.0])}, attrs={"jaxnh_version": "1", "title": "A title of ours"})
        assert format(ours)[0]["text/html"].startswith("<div><b>A title of ours")
        from matplotlib.figure import Figure  # none of pyplot's
        assert format(Figure())[0]["image/png"]
        assert "xr-wrap" in format(xr.Dataset())[0]["text/html"]
    """
    code = "\n".join(line[8:] for line in code.splitlines())
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_experiments_and_sessions():
    content = {
        "title": "Less < more",
        "system": {"constraint": "constant_speed"},
        "initial": {"x1": 0.1, "x2": 0.1, "y1": 0.1},
        "sweep": {"b": {"values": [5.5, 5.6]}},
        "accuracy": {"solver": "strang2", "steps": 40},
        "analyses": {"poincare": {"strobes": 4}},
    }
    experiment = jaxnh.Experiment.from_dict(content)
    assert "Less &lt; more" in experiment._repr_html_()
    assert "strang2" in experiment._repr_html_()
    session = jaxnh.Session(experiment)
    assert session._repr_html_() == "<b>Less &lt; more</b><br>a session over b (2)<br>not calibrated yet"
    assert repr(session) == "<Less < more, a session over b (2), not calibrated yet>"
    session.run("poincare", {"transient": 0, "strobes": 2})
    assert "<br>strang2, 40 steps a period, error of one period " in session._repr_html_()


def test_a_panel_on_axes_of_ones_own():
    """Drawn there, with the sweep's axis found through the tree; several panels have no place."""
    result = tree({"values": states(np.linspace(5.4, 5.6, 30), 8), "kinds": verdicts(FEW)})
    drawing = Figure()
    above, below = drawing.subplots(2)
    assert jaxnh.figure(result["values"], ax=above) is drawing
    assert "b" in above.get_xlabel()
    assert not below.has_data()
    with pytest.raises(ResultError, match="there are 2 panels, and axes have place for one"):
        jaxnh.figure(result, ax=below)
