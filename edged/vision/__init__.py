"""The numerical core: arrays in, values out; no clock, no I/O, no globals."""
