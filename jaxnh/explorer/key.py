"""Meanings of the colours of a plane, on the page: a legend, or a bar of a scale."""

from __future__ import annotations

import html

import numpy as np
from matplotlib.colors import to_hex

from jaxnh.plotting.pixels import Pixels

_STOPS = 33
_ENDS = 5  # numbers beside a bar


def key_html(pixels: Pixels) -> str:
    """The key to the colours of a plane; black is where a lane has failed."""
    entries = "".join(
        f"<span><i style='background:{html.escape(entry.colour)}'></i>{html.escape(entry.words)}</span>"
        for entry in pixels.entries
    )
    return f"<div class='key'><b>{html.escape(pixels.words)}</b>{entries or _bar(pixels)}</div>"


def _bar(pixels: Pixels) -> str:
    """Colours from the lowest to the highest, with numbers at even distances."""
    places = np.linspace(0.0, 1.0, _STOPS)
    stops = ", ".join(to_hex(pixels.colours(float(place))) for place in places)
    numbers = np.ma.getdata(pixels.norm.inverse(np.linspace(0.0, 1.0, _ENDS)))
    rounding = 1e-9 * np.ptp(numbers)
    ends = "".join(f"<span>{0.0 if abs(number) < rounding else number:.3g}</span>" for number in numbers)
    bar = f"<div class='bar' style='background:linear-gradient(to right, {stops})'></div>"
    return f"<div class='scale'>{bar}<div class='ends'>{ends}</div></div>"
