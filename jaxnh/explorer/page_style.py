"""Style of the page."""

from __future__ import annotations

CSS = """
:host { --mono: ui-monospace, monospace; }
.status { font-size: 14px; color: #333; min-height: 20px; }
.error { color: #a4000f; font-weight: 600; }
.notes { font-size: 12px; color: #666; }
table.lane { border-collapse: collapse; font-size: 14px; }
table.lane td { padding: 3px 14px 3px 0; vertical-align: top; }
table.lane td:first-child { color: #666; white-space: nowrap; }
.key { font-size: 13px; color: #333; display: flex; flex-wrap: wrap; gap: 2px 14px; align-items: center; }
.key i { display: inline-block; width: 13px; height: 13px; margin-right: 5px; vertical-align: -2px; }
.scale { width: 360px; }
.scale .bar { height: 12px; }
.gutter { text-align: right; color: #888; font: 13px/18px ui-monospace, monospace; padding: 8px 4px 0 0; }
.gutter { white-space: pre; }
.gutter b { background: #a4000f; color: white; }
.wrong { position: relative; font: 13px/18px sans-serif; color: #a4000f; }
.wrong div { position: absolute; padding-left: 8px; }
.scale .ends { display: flex; justify-content: space-between; font-size: 12px; }
"""
"""Style of its panes."""

HEAD = """\
{% block preamble %}<meta name="viewport" content="width=device-width, initial-scale=1">{% endblock %}
"""
"""Additions to the head of the page: on a telephone a pixel of the page is one of its screen's."""

NARROW = """
@media (max-width: 900px) {
  :host(.beside) { flex-direction: column !important; }
  :host(.aside) { flex-direction: column-reverse !important; }
  :host(.wrapped) { flex-wrap: wrap !important; }
  :host(.whole), :host(.beside), :host(.aside), :host(.wrapped) {
    flex: none !important; width: 100% !important; min-width: 0 !important; max-width: 100% !important;
  }
  :host(.line) { flex: none !important; width: calc(100% - 20px) !important; min-width: 0 !important; }
  :host(.square) { width: min(100%, 460px) !important; height: auto !important; aspect-ratio: 1; }
}
"""
"""Style of the page in a narrow window: what is side by side elsewhere is one below the other, and no wider than it."""
