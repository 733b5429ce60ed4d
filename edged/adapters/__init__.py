"""Adapters to foreign protocols, one module or package each; they translate foreign errors and units."""
