"""Style of the page, and its message when the server is gone."""

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
.scale .ends { display: flex; justify-content: space-between; font-size: 12px; }
"""
"""Style of its panes."""

LOST = """
const page = document.createElement("div")
page.textContent = "The server has stopped: what is on this page stays, and nothing new is computed. " +
  "Start jaxnh explore again and reload."
page.id = "lost"
page.style.cssText = "position:fixed;top:0;left:0;right:0;padding:10px;background:#a4000f;color:white;z-index:9999;" +
  "font-family:sans-serif;text-align:center"
if (!document.getElementById("lost")) document.body.appendChild(page)
"""
"""Run in the browser where the connection is lost."""
