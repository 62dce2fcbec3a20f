"""The explorer: a view of a bifurcation diagram or chart, computed as one looks, and the page that shows it."""
