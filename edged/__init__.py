"""edged: where is the workpiece? Two GenICam cameras in, coordinates with a sigma out."""

__version__ = "0.1.0"
