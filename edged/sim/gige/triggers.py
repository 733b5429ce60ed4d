"""Triggers of a virtual camera (software, line pulses, action commands), and its output lines."""

from __future__ import annotations

import time
from functools import partial

from edged.sim.gige import genicam as g
from edged.sim.gige.clock import DeviceClock
from edged.sim.gige.faults import Quirk
from edged.sim.gige.registers import ACTION_LATE, BUSY, NO_REFERENCE_TIME, SUCCESS, CameraRegisters
from edged.sim.gige.wiring import Debouncer, Due, TriggerQueue, Wire

LINE_SOURCES = {"Line1": g.LINE1, "Line3": g.LINE3}
OUTPUT = 1  # LineMode


class CameraTriggers:
    """Turns trigger events into exposures, as configured in the registers.

    lines : the wires at the camera's pins. queue : pending exposures. exposing : True from a software trigger
    until its image has been sent.
    """

    def __init__(self, registers: CameraRegisters, clock: DeviceClock, quirks: frozenset[Quirk]) -> None:
        self._registers, self._clock, self._quirks = registers, clock, quirks
        self.exposing = False
        self.queue = TriggerQueue()
        self.lines = {name: Wire() for name in g.LINES}
        self._inputs = {name: Debouncer(partial(self._accept, name)) for name in g.LINES}
        for name, wire in self.lines.items():
            wire.listen(partial(self._hear_edge, name))
        registers.hooks[g.TRIGGER_SOFTWARE] = self._by_software
        registers.live[g.LINE_STATUS_ALL] = self._levels
        for name, index in g.LINES.items():
            registers.live[g.LINE_STATUS + 4 * index] = partial(self._level, name)
            for bank in (g.LINE_MODE, g.LINE_INVERTER):
                registers.hooks[bank + 4 * index] = partial(self._rest, name)

    def act(self, keys: tuple[int, int, int], at_ticks: int | None) -> int | None:
        """Execute an action command if both keys match and the masks have a bit in common.

        keys : device key, group key, group mask. at_ticks : scheduled PTP time; None: at once. A command that
        comes too late is executed at once with the status `ACTION_LATE`.
        Returns its status, or None if it is for other devices. Source: GigE Vision 2.0, 14.3.
        """
        registers = self._registers
        device_key, group_key, mask = keys
        mine = registers.word(g.ACTION_DEVICE_KEY), registers.word(g.ACTION_GROUP_KEY)
        if (device_key, group_key) != mine or not mask & registers.word(g.ACTION_GROUP_MASK):
            return None
        if at_ticks is None:
            self._expose_if(g.ACTION1, time.monotonic_ns())
            return SUCCESS
        if not self._clock.locked:
            return NO_REFERENCE_TIME
        at_ns, now_ns = self._clock.monotonic_at(at_ticks), time.monotonic_ns()
        self._expose_if(g.ACTION1, max(at_ns, now_ns))
        return SUCCESS if at_ns >= now_ns else ACTION_LATE

    def drive_outputs(self, at_ns: int, exposure_us: float) -> None:
        """Drive the outputs set to ExposureActive for an exposure that begins at this monotonic time."""
        for name, number in g.LINES.items():
            index = 4 * number
            source = self._registers.word(g.LINE_SOURCE + index)
            if self._is_output(name) and source == g.EXPOSURE_ACTIVE:
                rest = bool(self._registers.word(g.LINE_INVERTER + index))
                self.lines[name].drive(not rest, at_ns)
                self.lines[name].drive(rest, at_ns + round(exposure_us * 1e3))

    def _expose_if(self, source: int, at_ns: int) -> Due | None:
        """Queue an exposure if the camera waits for this trigger source."""
        registers = self._registers
        waits = registers.word(g.TRIGGER_MODE) == 1 and registers.word(g.TRIGGER_SOURCE) == source
        if not (waits and registers.acquiring):
            return None
        return self.queue.put(at_ns + round(registers.number(g.TRIGGER_DELAY) * 1e3))

    def _by_software(self, _word: int) -> int:
        if self.exposing and Quirk.BUSY_REFUSES in self._quirks:
            return BUSY
        if not (self.exposing and Quirk.BUSY_DROPS in self._quirks):
            self.exposing = self._expose_if(g.SOFTWARE, time.monotonic_ns()) is not None or self.exposing
        return SUCCESS

    def _is_output(self, line: str) -> bool:
        return self._registers.word(g.LINE_MODE + 4 * g.LINES[line]) == OUTPUT

    def _hear_edge(self, line: str, level: bool, at_ns: int) -> None:
        if self._is_output(line):
            return
        index = 4 * g.LINES[line]
        level ^= bool(self._registers.word(g.LINE_INVERTER + index))
        debounce_s = self._registers.number(g.LINE_DEBOUNCER + index) * 1e-6
        self._inputs[line].edge(level, at_ns, debounce_s)

    def _accept(self, line: str, level: bool, at_ns: int) -> Due | None:
        ignored = g.FALLING if level else g.RISING
        if line not in LINE_SOURCES or self._registers.word(g.TRIGGER_ACTIVATION) == ignored:
            return None
        return self._expose_if(LINE_SOURCES[line], at_ns)

    def _rest(self, line: str, _word: int) -> int:
        """Drive an output to its idle level, which its inverter determines."""
        if self._is_output(line):
            self.lines[line].drive(bool(self._registers.word(g.LINE_INVERTER + 4 * g.LINES[line])))
        return SUCCESS

    def _level(self, line: str) -> bool:
        inverted = bool(self._registers.word(g.LINE_INVERTER + 4 * g.LINES[line]))
        return self.lines[line].level(time.monotonic_ns()) ^ inverted

    def _levels(self) -> int:
        return sum(self._level(name) << index for name, index in g.LINES.items())
