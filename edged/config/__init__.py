"""The configuration file: one TOML file, checked as a whole.

All mistakes are reported at once, each with its dotted path. Unknown keys are mistakes: a misspelt limit
that is silently ignored is worse than a daemon that does not start. People write degrees and milliseconds
here; everything is converted once, where the values leave this package.
"""
