"""The explorer: a view of a bifurcation diagram or chart, computed on demand, and the page that shows it."""
