"""The error class of the atomistic solver."""


class EngineError(RuntimeError):
    """The atomistic solver cannot go on; the message names the cause, the place and the likely knob."""
