"""The verbs of setting a cell up: no console, no HTTP; command line and page are their callers."""
