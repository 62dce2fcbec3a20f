"""Display of a result in a notebook: title, errors, and a small picture, above xarray's own list.

It is made, and matplotlib imported, only on display.
"""

from __future__ import annotations

import base64
import io
import sys
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from jaxnh.exceptions import JaxnhError
from jaxnh.jobs.attributes import steps_in_words, turn_in_words
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.groups import kind_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH = 4.6  # inches
_TALLEST = 12.0  # inches
_DOTS = 90  # an inch
_LARGEST = 1 << 26  # bytes of a result that is still drawn unasked
_MOST_ROWS = 12
_CELL = "style='text-align:left;padding-right:1em'"
_XARRAYS = (("xarray.core.dataset", "Dataset"), ("xarray.core.datatree", "DataTree"))


def register() -> None:
    """Register these displays of results, and of figures as pictures, in a running notebook.

    A matplotlib figure that pyplot has not made is shown as a picture only where pyplot has been imported before.
    """
    shell: Any = sys.modules["IPython"].get_ipython()
    formatter = getattr(shell, "display_formatter", None)
    if formatter is not None:
        for module, name in _XARRAYS:
            formatter.formatters["text/html"].for_type_by_name(module, name, html)
        formatter.formatters["image/png"].for_type_by_name("matplotlib.figure", "Figure", png)


def png(drawing: Figure, dots: int = _DOTS) -> bytes:
    """A figure as a picture of so many dots an inch, in the style of the package."""
    from jaxnh.plotting.style import package_style

    file = io.BytesIO()
    with package_style():
        drawing.savefig(file, format="png", dpi=dots)
    return file.getvalue()


def html(result: xr.DataTree | xr.Dataset) -> str:
    """A result, a group of one, or a dataset of a session as HTML; any other dataset as xarray shows it."""
    plain = result._repr_html_()
    about = dict(result.root.attrs if isinstance(result, xr.DataTree) else {}) | dict(result.attrs)
    groups = _groups(result)
    if "jaxnh_version" not in about and not any(map(kind_of, groups.values())):
        return plain
    name = result.name if isinstance(result, xr.DataTree) else None
    title = str(about.get("title") or name or "dataset of jaxnh")
    axes = " and ".join(f"{axis} ({size:,})" for axis, size in _axes(groups, str(about.get("axes", ""))).items())
    lines = [f"<b>{escape(title)}</b>{f', over {escape(axes)}' if axes else ''}"]
    if "error_estimate" in about:
        turn, error = turn_in_words(about), float(about["error_estimate"])
        lines.append(f"{escape(str(about['solver']))}, {steps_in_words(about)}, error of one {turn} {error:.1g}")
    rows = [row for name, data in groups.items() for row in _rows(name, data)]
    more = f"<br>… and {len(rows) - _MOST_ROWS} more" if len(rows) > _MOST_ROWS else ""
    heads = "".join(f"<th {_CELL}>{head}</th>" for head in ("", "values", "largest error", "units"))
    table = f"<table><tr>{heads}</tr>{''.join(rows[:_MOST_ROWS])}</table>{more}" if rows else ""
    words = "<br>".join(lines)
    return f"<div>{words}{table}{_picture(result, groups)}<details><summary>all of it</summary>{plain}</details></div>"


def _groups(result: xr.DataTree | xr.Dataset) -> dict[str, xr.Dataset]:
    """Datasets by the name of their group; "" where it stands alone."""
    if isinstance(result, xr.Dataset):
        return {"": describe("", result)}
    groups = {str(name): describe(str(name), node.to_dataset()) for name, node in result.children.items()}
    return groups or {"": describe(result.name or "", result.to_dataset())}


def _axes(groups: dict[str, xr.Dataset], names: str) -> dict[str, int]:
    sizes = {str(name): size for data in groups.values() for name, size in data.sizes.items()}
    return {name: sizes[name] for name in names.split() if name in sizes}


def _rows(group: str, data: xr.Dataset) -> list[str]:
    """A row a variable that the panel is of or that has an error: its words, range, largest error and units."""
    drawn = str(data.attrs.get("panel_variables", "")).split()
    rows = []
    for key, variable in data.data_vars.items():
        name, error = str(key), data.get(f"{key}_error")
        if (error is None and name not in drawn) or variable.dtype.kind not in "fiu":
            continue
        words = escape(str(variable.attrs.get("long_name", name)))
        cells = [f"{escape(group)}: {words}" if group else words, _range(variable)]
        cells += ["" if error is None else _largest(error), escape(str(variable.attrs.get("units", "")))]
        rows.append("<tr>" + "".join(f"<td {_CELL}>{cell}</td>" for cell in cells) + "</tr>")
    return rows


def _range(variable: xr.DataArray) -> str:
    """The ends of its values; of flags their words."""
    values = np.unique(variable.to_numpy())
    if "flag_meanings" in variable.attrs and "valid_min" not in variable.attrs:
        meanings = str(variable.attrs["flag_meanings"]).split()
        words = dict(zip(np.ravel(variable.attrs["flag_values"]).tolist(), meanings, strict=True))
        return escape(", ".join(words.get(value, str(value)) for value in values[:_MOST_ROWS].tolist()))
    values = values[np.isfinite(values)]
    if not values.size:
        return "–"
    low, high = f"{values[0]:.6g}", f"{values[-1]:.6g}"
    return low if low == high else f"{low} … {high}"


def _largest(error: xr.DataArray) -> str:
    finite = error.to_numpy()[np.isfinite(error.to_numpy())]
    return f"{finite.max():.1g}" if finite.size else "–"


def _picture(result: xr.DataTree | xr.Dataset, groups: Mapping[str, xr.Dataset]) -> str:
    """A small picture as an element of a page, of the first group alone where all make a tall one; or ""."""
    if result.nbytes > _LARGEST:
        return f"<p>{result.nbytes >> 20} MiB: jaxnh.figure draws it</p>"
    from jaxnh.plotting.results import figure
    from jaxnh.plotting.style import Size

    try:
        drawing, more = figure(result, size=Size(_WIDTH)), ""
        if drawing.get_figheight() > _TALLEST and isinstance(result, xr.DataTree) and result.children:
            name, group = next(item for item in result.children.items() if kind_of(groups[str(item[0])]))
            drawing = figure(group, size=Size(_WIDTH))
            more = f"<br>{escape(name)} alone; jaxnh.figure draws all of it"
        picture = png(drawing)
    except JaxnhError:
        return ""
    return f"<br><img alt='picture' src='data:image/png;base64,{base64.b64encode(picture).decode()}'>{more}"
