"""Scripts of the browser: keys, touch, the rotation of a portrait, and the message when the server is gone."""

from __future__ import annotations

LOST = """
const page = document.createElement("div")
page.textContent = "The server has stopped: what is on this page stays, and nothing new is computed. " +
  "Start jaxnh explore again and reload."
page.id = "lost"
page.style.cssText = "position:fixed;top:0;left:0;right:0;padding:10px;background:#a4000f;color:white;z-index:9999;" +
  "font-family:sans-serif;text-align:center"
if (!document.getElementById("lost")) document.body.appendChild(page)
"""
"""Run where the connection is lost."""

KEYS = [
    ("← → ↑ ↓", "move the view by a fifth"),
    ("+ −", "zoom in and out, about the middle"),
    ("0", "the whole range"),
    ("[ ]", "back and forward, as the buttons"),
    ("shift ← → ↑ ↓", "turn the portrait in space"),
    ("escape", "close this, or let go of what was clicked"),
    ("?", "these keys"),
]
"""Keys of the page, and what they do."""

KEYBOARD = """
const known = window.jaxnh_page
if (known && known.pressed === pressed) return
window.jaxnh_page = {pressed, camera}
if (window.matchMedia("(pointer: coarse)").matches) pan.active = true
if (known) return
const toggle = (show) => {
  let box = document.getElementById("keys")
  if (box) { box.remove(); if (!show) return true }
  if (!show) return false
  box = document.createElement("div")
  box.id = "keys"
  box.setAttribute("role", "dialog")
  box.setAttribute("aria-label", "Keys of this page")
  box.style.cssText = "position:fixed;top:90px;left:50%;transform:translateX(-50%);background:white;z-index:9998;" +
    "padding:14px 24px;border:1px solid #888;box-shadow:0 4px 24px #0004;font:14px sans-serif"
  const table = document.createElement("table")
  for (const [key, words] of keys) {
    const row = table.insertRow()
    for (const text of [key, words]) {
      const cell = row.insertCell()
      cell.textContent = text
      cell.style.padding = "3px 12px 3px 0"
    }
    row.cells[0].style.fontWeight = "600"
  }
  box.appendChild(table)
  document.body.appendChild(box)
  return true
}
let count = 0
document.addEventListener("keydown", (event) => {
  const target = event.composedPath()[0]
  const typing = ["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName) || target.isContentEditable
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return
  const known = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "+", "=", "-", "0", "[", "]", "Escape", "?"]
  if (!known.includes(event.key)) return
  event.preventDefault()
  if (event.key == "?") return toggle(!document.getElementById("keys"))
  if (event.key == "Escape" && toggle(false)) return
  const {pressed, camera} = window.jaxnh_page
  if (event.shiftKey && event.key.startsWith("Arrow")) {
    const turn = {ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5]}[event.key]
    const old = camera.data
    const elevation = Math.max(-90, Math.min(90, old.elevation[0] + turn[1]))
    camera.data = {azimuth: [old.azimuth[0] + turn[0]], elevation: [elevation]}
    return
  }
  count += 1
  pressed.tags = [event.key, count]
})
"""
"""Run where a picture is shown: `keys` are words of the help, `pressed` is told of a key, `pan` drags on touch."""

TURNED = """
const [azimuth, elevation] = [camera.data.azimuth[0], camera.data.elevation[0]].map((angle) => angle * Math.PI / 180)
const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)]
const across = (u, v) => -sa * u + ca * v
const up = (u, v, w) => -se * (ca * u + sa * v) + ce * w
const near = (u, v, w) => ce * (ca * u + sa * v) + se * w
for (const source of sources) {
  const {u, v, w} = source.data
  const n = u.length
  const data = {...source.data, x: new Float64Array(n), y: new Float64Array(n), alpha: new Float64Array(n)}
  const ends = "u1" in data
  if (ends) { data.x1 = new Float64Array(n); data.y1 = new Float64Array(n) }
  for (let k = 0; k < n; k++) {
    data.x[k] = across(u[k], v[k])
    data.y[k] = up(u[k], v[k], w[k])
    data.alpha[k] = Math.max(0.15, Math.min(1.0, 0.6 + 0.3 * near(u[k], v[k], w[k])))
    if (ends) {
      data.x1[k] = across(data.u1[k], data.v1[k])
      data.y1[k] = up(data.u1[k], data.v1[k], data.w1[k])
    }
  }
  source.data = data
}
"""
"""Points (u, v, w) as a camera sees them, in parallel projection; what is nearer is darker."""

DRAGGED = """
const old = camera.data
if (cb_obj.event_name == "panstart") { window.jaxnh_from = [cb_obj.sx, cb_obj.sy, old.azimuth[0], old.elevation[0]] }
else if (cb_obj.event_name == "pan" && window.jaxnh_from) {
  const [sx, sy, azimuth, elevation] = window.jaxnh_from
  const turned = Math.max(-90, Math.min(90, elevation + 0.5 * (cb_obj.sy - sy)))
  camera.data = {azimuth: [azimuth - 0.5 * (cb_obj.sx - sx)], elevation: [turned]}
}
"""
"""A drag turns the camera."""

COLUMNS = """
legend.ncols = Math.max(1, Math.min(most, Math.floor(cb_obj.inner_width / 150)))
"""
"""The legend is no wider than the figure: an entry has 150 pixels."""
