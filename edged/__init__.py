"""edged: where is the workpiece? Two GenICam cameras in, coordinates with a sigma out.

    from edged import load_rig, load_job, calibrate, teach, locate

imports the method as a library, see `edged.library`; it is loaded when one of its names is first used.
"""

TYPE_CHECKING = False  # not imported from `typing`, so that importing edged loads nothing
if TYPE_CHECKING:
    from edged.library import calibrate, load_job, load_rig, locate, save_job, save_rig, teach

__version__ = "0.1.0"
__all__ = ["calibrate", "load_job", "load_rig", "locate", "save_job", "save_rig", "teach"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'edged' has no attribute {name!r}")
    import edged.library

    return getattr(edged.library, name)
