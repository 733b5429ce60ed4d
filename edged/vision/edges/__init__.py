"""From pixels to sub-pixel edges, contours, lines, arcs and ellipses (paper, 4.1)."""
