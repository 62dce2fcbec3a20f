"""Edge states on the boundaries of basins of attraction, and the least shocks that cross them."""
