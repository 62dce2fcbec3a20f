"""Layers drawn over the figure of a view, with a legend that switches each on and off."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from bokeh.core.properties import value
from bokeh.models import ColumnDataSource, CustomJS, GlyphRenderer, Legend, LegendItem, MultiLine, Scatter, Text, VStrip
from bokeh.plotting import figure

from jaxnh.explorer.layers import Hit, Layer, Scale, nearest, thin
from jaxnh.explorer.page_scripts import COLUMNS

_DASHES = ("solid", "dashed", "dotted", "dashdot")
_ENTRIES = 4  # of the legend in a row
_SIZE = 7  # pixels, of a mark
_WORDS = {"text_font_size": "12px", "x_offset": 6, "y_offset": -4}


class LayerDrawing:
    """Layers over a figure.

    Attributes:
        layers: those that are drawn, hidden or not.
        hidden: names of those that are switched off.
    """

    def __init__(self, drawn: figure, hidden: Collection[str], *, edged: bool) -> None:
        """Nothing is drawn yet.

        Args:
            drawn: figure of the view.
            hidden: names of layers that are switched off from the beginning.
            edged: whether lines have a white edge, as over colours.
        """
        self._figure, self._edged = drawn, edged
        self.layers: Sequence[Layer] = ()
        self.hidden = set(hidden)
        self._renderers: list[list[GlyphRenderer]] = []
        self._legend = Legend(
            items=[], click_policy="hide", ncols=_ENTRIES, visible=False, border_line_alpha=0.0,
            location="left", label_text_font_size="12px",
            inactive_fill_color="white", inactive_fill_alpha=0.75, spacing=12,
        )  # fmt: skip
        drawn.add_layout(self._legend, "above")
        drawn.js_on_change("inner_width", CustomJS(args={"legend": self._legend, "most": _ENTRIES}, code=COLUMNS))

    def show(self, layers: Sequence[Layer]) -> None:
        """Draw other layers, if they are others; `fit` gives them their points."""
        if layers is self.layers:
            return
        for renderer in [each for group in self._renderers for each in group]:
            self._figure.renderers.remove(renderer)
        self.layers, self._renderers = layers, [self._add(layer) for layer in layers]
        pairs = zip(layers, self._renderers, strict=True)
        self._legend.items = [LegendItem(label=layer.name, renderers=list(drawn)) for layer, drawn in pairs]
        self._legend.visible = bool(layers)

    def fit(self, scale: Scale) -> None:
        """Give every layer the points that a view needs."""
        for layer, renderers in zip(self.layers, self._renderers, strict=True):
            if layer.glyph == "line":
                lines = [thin(item, scale) for item in layer.items]
                data = {"x": [x for x, _ in lines], "y": [y for _, y in lines]}
            elif layer.glyph == "dots":
                data = {name: np.concatenate([getattr(item, name) for item in layer.items]) for name in ("x", "y")}
            else:
                data = {name: [float(item.x[k]) for item in layer.items] for k, name in enumerate(("x0", "x1"))}
            for each in renderers:
                each.data_source.update(data=data)

    def hit(self, x: float, y: float, scale: Scale) -> Hit | None:
        """Return what is clicked at, of the layers that are switched on."""
        return nearest([layer for layer in self.layers if layer.name not in self.hidden], x, y, scale)

    def _add(self, layer: Layer) -> list[GlyphRenderer]:
        source, drawn = ColumnDataSource({"x": [], "y": []}), self._figure
        if layer.glyph == "line":
            dash = _DASHES[layer.dash % len(_DASHES)]
            glyphs = [MultiLine(xs="x", ys="y", line_color=layer.colour, line_width=1.6, line_dash=dash)]
            edge = MultiLine(xs="x", ys="y", line_color="white", line_width=3.4, line_alpha=0.8)
            glyphs = [edge, *glyphs] if self._edged else glyphs
        elif layer.glyph == "dots":
            *hollow, marker = layer.mark.split()
            fill = "white" if hollow else layer.colour
            glyphs = [Scatter(x="x", y="y", size=_SIZE, marker=marker, fill_color=fill, line_color=layer.colour)]
            if layer.label:  # an outline is drawn over its letters, so that it goes below them
                words = {"x": "x", "y": "y", "text": value(layer.label), **_WORDS}
                glyphs += [Text(text_outline_color="white", text_outline_width=3, **words), Text(**words)]
        else:
            source = ColumnDataSource({"x0": [], "x1": []})
            glyphs = [VStrip(x0="x0", x1="x1", fill_color=layer.colour, fill_alpha=0.35, line_alpha=0.0)]
        visible = layer.name not in self.hidden
        renderers = [drawn.add_glyph(source, glyph, visible=visible) for glyph in glyphs]
        renderers[0].on_change("visible", lambda _, __, now: self._switch(layer, renderers, now))
        return renderers

    def _switch(self, layer: Layer, renderers: Sequence[GlyphRenderer], visible: bool) -> None:
        (self.hidden.discard if visible else self.hidden.add)(layer.name)
        for other in renderers[1:]:
            other.visible = visible
