"""Sub-pixel edges, contours, lines, arcs and ellipses from pixels (paper, 4.1)."""
