"""Shape matching after the paper, section 4.2 (eq. 6 and 7)."""
